"""MPEG-4 videos with packets that hold no picture."""

from fractions import Fraction

import av
import numpy as np
import pytest

from gaussray.capture.errors import CaptureError
from gaussray.capture.video_times import picture_ticks
from gaussray.capture.videos import decode_frames, read_video
from gaussray.prepare.motion import motion_energy, motion_signal
from gaussray.prepare.sources import find_sources


COUNT, PLACES = 10, (2, 5)
# What XviD writes while its encoder waits, and a picture's header that says that none is coded.
WAITING, NOT_CODED = b"\x7f", bytes.fromhex("000001b651cf")
# FFmpeg reads such packets only of encoders that are known to write them.
_ENCODER = b"\0\0\1\xb2DivX503b1393"


def placeholders(path, payload):
    """A video of ten frames, each of its own grey, with a placeholder before the pictures 2 and 5,
    which takes the time of a frame in the file."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream("mpeg4", rate=30)
        stream.height, stream.width, stream.pix_fmt = 32, 48, "yuv420p"
        packets = []
        for i in range(COUNT):
            # Noise, so that no picture is as small as a placeholder.
            levels = np.random.default_rng(i).integers(0, 256, (32, 48, 3)).astype(np.uint8)
            levels[:, 24:] = 16 + 12 * i
            packets += stream.encode(av.VideoFrame.from_ndarray(levels, format="rgb24"))
        packets = [bytes(packet) for packet in [*packets, *stream.encode()] if packet.size]
        start = packets[0].find(b"\0\0\1\xb6")
        packets[0] = packets[0][:start] + _ENCODER + packets[0][start:]
        for place in reversed(PLACES):
            packets.insert(place, payload)
        for tick, data in enumerate(packets):
            packet = av.Packet(data)
            packet.stream, packet.time_base = stream, Fraction(1, 30)
            packet.pts = packet.dts = tick
            packet.is_keyframe = tick == 0
            file.mux(packet)
    return path


def shown(picture):
    """Which picture it is, by the grey of its right half."""
    return round((float(np.mean(picture[:, 36:])) - 16) / 12)


def test_packets_of_an_encoder_that_waits_are_no_frames(tmp_path):
    path = placeholders(tmp_path / "a.avi", WAITING)
    assert read_video(path) == (48, 32, COUNT)
    assert [shown(p) for p in decode_frames(path, range(COUNT))] == list(range(COUNT))
    with pytest.raises(CaptureError, match="in 0 ... 9, got 10"):
        list(decode_frames(path, [COUNT]))
    (source,) = find_sources(tmp_path)
    assert source.times * 30 == pytest.approx(np.arange(COUNT)) and source.is_even
    energy = motion_energy(source)
    assert len(energy) == COUNT and np.isfinite(motion_signal(source.times, energy)).all()


def test_a_picture_that_is_shown_again_leaves_a_gap(tmp_path):
    path = placeholders(tmp_path / "a.avi", NOT_CODED)
    (source,) = find_sources(tmp_path)
    assert source.times * 30 == pytest.approx([0, 1, 3, 4, 5, 7, 8, 9, 10, 11])
    assert not source.is_even and len(motion_energy(source)) == source.count == COUNT
    # Readers of captures count frames, so they refuse it; `prepare` makes pictures of it.
    with pytest.raises(CaptureError, match="evenly spaced in time.*fps=30"):
        read_video(path)


def test_packets_of_other_codecs_are_pictures(tmp_path):
    assert picture_ticks(tmp_path / "none.webm", "libvpx-vp9", [(2, 400), (1, 2), (0, 1)]) == [
        *(0, 1, 2)
    ]
    with pytest.raises(OSError, match="no times"):
        picture_ticks(tmp_path / "none.mp4", "h264", [(None, 400)])
