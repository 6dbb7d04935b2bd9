"""Many pictures at a time: in one type, each once, as a function arranges them."""

import threading

import films
import numpy as np
import pytest
from picture_files import Picture, random_codes, write

from gaussray.capture.errors import CaptureError
from gaussray.capture.picture_stream import decoding_threads, stream_encoded
from gaussray.capture.videos import frame_path
from gaussray.color import srgb_encode
from gaussray.runtime import side_by_side


# Seconds after which a thread that waits for another has waited in vain.
_IN_VAIN = 20.0


def test_eight_bit_files_stay_bytes(tmp_path):
    stack = np.stack([random_codes() // (k + 1) for k in range(5)])
    views = [Picture(write(tmp_path / f"{k}.png", p), 32, 24) for k, p in enumerate(stack)]
    loaded = films.load(views)
    assert loaded.dtype == np.uint8
    np.testing.assert_array_equal(loaded, stack)


def test_one_float_file_makes_all_of_them_float(tmp_path):
    codes = random_codes()
    linear = np.full((24, 32, 3), 0.5, np.float32)
    views = [
        Picture(write(tmp_path / "0.png", codes), 32, 24),
        Picture(write(tmp_path / "1.exr", linear), 32, 24),
        Picture(write(tmp_path / "2.png", codes), 32, 24),
    ]
    loaded = films.load(views)
    assert loaded.dtype == np.float32
    np.testing.assert_allclose(loaded[[0, 2]], np.stack([codes, codes]) / 255, rtol=1e-6)
    np.testing.assert_allclose(loaded[1], srgb_encode(linear), rtol=1e-6)


def test_views_of_two_sizes_are_not_stacked(tmp_path):
    views = [Picture(tmp_path / "0.png", 32, 24), Picture(tmp_path / "1.png", 16, 24)]
    with pytest.raises(CaptureError, match="1.png: all views.*16 x 24 after 32 x 24"):
        films.load(views)


def test_a_missing_picture_among_many_stops_the_loading(tmp_path):
    path = write(tmp_path / "0.png", random_codes())
    with pytest.raises(FileNotFoundError, match="1.png"):
        films.load([Picture(path, 32, 24), Picture(tmp_path / "1.png", 32, 24)])


def test_each_picture_is_arranged_with_its_index_in_a_thread_of_several(tmp_path):
    stack = np.stack([random_codes() // (k + 1) for k in range(4)])
    views = [Picture(write(tmp_path / f"{k}.png", p), 32, 24) for k, p in enumerate(stack)]
    meeting = threading.Barrier(2, timeout=_IN_VAIN)

    def sums(index, picture):
        # Alone, no thread ever gets past it.
        meeting.wait()
        return index, picture.sum(dtype=int)

    dtype, pictures = stream_encoded(views, sums)
    assert dtype == np.uint8
    expected = [(k, (k, picture.sum(dtype=int))) for k, picture in enumerate(stack)]
    assert list(pictures) == expected


def test_views_may_share_a_frame_of_a_video(tmp_path):
    films.film(tmp_path / "v.mp4", films.shades(3, 320, 240))
    listed = [2, 0, 2, 2, 1, 2, 0, 2]
    views = [Picture(frame_path(tmp_path / "v.mp4", k), 320, 240) for k in listed]
    loaded = films.load(views)
    assert [films.index_of(picture) for picture in loaded] == listed


@pytest.mark.parametrize(("side", "threads"), [(1000, 16), (5000, 4), (9000, 4)])
def test_few_large_pictures_are_decoded_at_the_same_time(monkeypatch, side, threads):
    monkeypatch.setattr(side_by_side, "cores", lambda: 32)
    assert decoding_threads(side * side) == threads
