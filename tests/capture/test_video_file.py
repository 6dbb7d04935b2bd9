"""What a video file must be before its frames are decoded, and how they are turned."""

from types import SimpleNamespace

import av
import films
import numpy as np
import pytest

from gaussray.capture import video_file
from gaussray.capture.errors import CaptureError
from gaussray.capture.video_file import (
    CODECS,
    damaged_video,
    decoded_frames,
    open_video,
    upright,
    video_state,
    video_stream,
)


PATH = "cam.mp4"


def decoded(rotation, size=(4, 2)):
    """A decoded frame of these columns and rows; its levels count up."""
    return SimpleNamespace(rotation=rotation, width=size[0], height=size[1])


@pytest.fixture
def levels(monkeypatch):
    """The levels that any decoded frame has."""
    rows = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    monkeypatch.setattr(video_file, "frame_levels", lambda _: rows)
    return rows


@pytest.mark.parametrize("turns", [0, 1, 2, 3, -1])
def test_a_frame_is_turned_counterclockwise_by_quarters(tmp_path, levels, turns):
    found = upright(tmp_path / PATH, decoded(90 * turns))
    expected = levels
    for _ in range(turns % 4):
        # What was the last column is the first row.
        expected = expected.transpose(1, 0, 2)[::-1]
    np.testing.assert_array_equal(found, expected)
    assert found.flags["C_CONTIGUOUS"]


def test_other_turns_and_frames_beyond_the_limit_are_refused(tmp_path, levels):
    with pytest.raises(CaptureError, match="quarters of a turn, got 45 degrees"):
        upright(tmp_path / PATH, decoded(45))
    with pytest.raises(CaptureError, match="megapixels of a frame"):
        upright(tmp_path / PATH, decoded(0, (1_000_000, 1_000_000)))


def test_only_streams_of_pictures_by_common_codecs_are_taken(tmp_path):
    def stream(name, size=(4, 2)):
        codec = SimpleNamespace(name=name, width=size[0], height=size[1], is_open=True)
        streams = SimpleNamespace(video=[SimpleNamespace(codec_context=codec)])
        return video_stream(tmp_path / PATH, SimpleNamespace(streams=streams))

    for name in CODECS:
        assert stream(name).codec_context.name == name
    with pytest.raises(CaptureError, match="encoded by one of .*, got cinepak"):
        stream("cinepak")
    with pytest.raises(CaptureError, match="megapixels of a frame"):
        stream("h264", (1_000_000, 1_000_000))
    with pytest.raises(CaptureError, match="must hold a stream of pictures, got none"):
        video_stream(tmp_path / PATH, SimpleNamespace(streams=SimpleNamespace(video=[])))


def test_all_frames_come_in_the_order_in_which_they_are_shown(tmp_path):
    path = films.film(tmp_path / PATH, films.shades(6))
    found = [films.index_of(upright(path, frame)) for frame in decoded_frames(path)]
    assert found == list(range(6))


def test_playlists_and_other_files_are_no_videos(tmp_path):
    films.film(tmp_path / "real.mp4", films.shades(1))
    playlist = tmp_path / PATH
    playlist.write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nreal.mp4\n")
    with pytest.raises(OSError, match="cam.mp4: the video is truncated or corrupt"):
        with open_video(playlist):
            pass


def test_an_error_of_the_decoder_names_the_file_also_within_the_block(tmp_path):
    path = films.film(tmp_path / PATH, films.shades(1))
    with pytest.raises(OSError, match="cam.mp4: the video is truncated or corrupt: why"):
        with open_video(path):
            raise av.error.InvalidDataError(1, "why")
    assert "Copy or encode it again" in str(damaged_video(path, "why"))


def test_what_is_cached_of_a_video_ends_with_its_last_change(tmp_path):
    path = tmp_path / PATH
    path.write_bytes(b"four")
    state = video_state(path)
    assert state == (path, path.stat().st_mtime_ns, 4) and video_state(path) == state
    path.write_bytes(b"other")
    assert video_state(path) != state
    with pytest.raises(FileNotFoundError, match="does not exist"):
        video_state(tmp_path / "none.mp4")
    with pytest.raises(OSError, match="must be a file, got a folder"):
        video_state(tmp_path)
