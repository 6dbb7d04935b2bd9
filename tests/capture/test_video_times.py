"""When the pictures of a video are shown."""

import numpy as np
import pytest

from gaussray.capture import video_times
from gaussray.capture.errors import CaptureError
from gaussray.capture.video_times import check_even_ticks, picture_ticks


# Bytes of packets: of an encoder that waits, of a picture that is shown again, of a picture.
WAITS, AGAIN, PICTURE = 1, 7, 400


@pytest.fixture
def shown(monkeypatch, tmp_path):
    """The ticks of packets of these bytes, of which so many pictures are decoded."""

    def ticks(sizes, count, codec="mpeg4"):
        path = tmp_path / f"{count}.avi"
        path.write_bytes(b"")
        monkeypatch.setattr(video_times, "decoded_frames", lambda _: iter(range(count)))
        # Each call counts anew: the file is another one.
        path = path.rename(tmp_path / f"{count}_{'_'.join(map(str, sizes))}.avi")
        return picture_ticks(path, codec, [(10 * i, size) for i, size in enumerate(sizes)])

    return ticks


def test_every_packet_of_another_codec_is_a_picture(shown):
    assert shown([PICTURE, AGAIN, WAITS], 3, "h264") == [0, 10, 20]


def test_pictures_follow_at_one_interval_while_an_encoder_waits(shown):
    """The last ticks belong to no picture."""
    assert shown([PICTURE, WAITS, PICTURE, WAITS, PICTURE], 3) == [0, 10, 20]


def test_a_picture_that_is_shown_again_leaves_a_gap(shown):
    assert shown([PICTURE, AGAIN, PICTURE, PICTURE], 3) == [0, 20, 30]


def test_a_small_packet_after_one_with_two_pictures_is_a_picture(shown):
    assert shown([PICTURE, AGAIN, PICTURE, PICTURE], 4) == [0, 10, 20, 30]


def test_of_several_small_packets_the_smallest_are_no_pictures(shown):
    assert shown([PICTURE, AGAIN + 1, PICTURE, AGAIN, PICTURE], 4) == [0, 10, 20, 40]


def test_packets_that_can_not_be_decoded_are_an_error(shown):
    with pytest.raises(OSError, match="2 of 4 frames can be decoded"):
        shown([PICTURE, AGAIN, PICTURE, PICTURE], 2)


def test_packets_are_sorted_by_their_ticks_and_each_must_have_one(tmp_path):
    packets = [(20, PICTURE), (0, PICTURE), (10, PICTURE)]
    assert picture_ticks(tmp_path / "a.mp4", "h264", packets) == [0, 10, 20]
    with pytest.raises(OSError, match="its frames have no times"):
        picture_ticks(tmp_path / "a.mp4", "h264", [*packets, (None, PICTURE)])


@pytest.mark.parametrize("order", [1, -1])
def test_intervals_may_differ_by_a_quarter(tmp_path, order):
    even = np.cumsum([0, 100, 100, 125, 75, 100])[::order]
    check_even_ticks(tmp_path / "a.mp4", even.tolist())
    check_even_ticks(tmp_path / "a.mp4", [7])
    check_even_ticks(tmp_path / "a.mp4", [])
    uneven = np.cumsum([0, 100, 100, 126, 100])[::order]
    with pytest.raises(CaptureError, match="got 126 ticks after frame 2 and 100 elsewhere"):
        check_even_ticks(tmp_path / "a.mp4", uneven.tolist())
