"""Videos that play: the frames that went in come out."""

import av
import numpy as np
import pytest

from gaussray.dataset.video import write_video


def read(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        return stream.average_rate, [f.to_ndarray(format="rgb24") for f in container.decode(stream)]


def test_number_size_rate_and_colours_of_the_frames_survive(tmp_path):
    shades = [(200, 30, 30), (30, 200, 30), (30, 30, 200), (128, 128, 128), (255, 255, 0)]
    frames = [np.full((96, 128, 3), shade, np.uint8) for shade in shades]
    write_video(tmp_path / "v.mp4", frames, 12, least=0)
    rate, read_back = read(tmp_path / "v.mp4")
    assert rate == 12 and len(read_back) == 5 and read_back[0].shape == (96, 128, 3)
    for got, shade in zip(read_back, shades, strict=True):
        # 8-bit limited-range YUV at half the colour resolution.
        assert np.abs(got[48, 64].astype(int) - shade).max() <= 6


def test_small_pictures_are_enlarged_and_odd_sides_made_even(tmp_path):
    write_video(tmp_path / "v.mp4", iter([np.zeros((33, 51, 3), np.float32)] * 3), 29.97)
    rate, frames = read(tmp_path / "v.mp4")
    assert frames[0].shape == (264, 408, 3) and len(frames) == 3
    assert float(rate) == pytest.approx(29.97, abs=1e-3)
    write_video(tmp_path / "odd.mp4", [np.zeros((33, 51, 3), np.float32)], 5, least=0)
    assert read(tmp_path / "odd.mp4")[1][0].shape == (34, 52, 3)


def test_linear_light_is_encoded_as_srgb(tmp_path):
    write_video(tmp_path / "v.mp4", [np.full((64, 64, 3), 0.5)], 5)
    assert abs(int(read(tmp_path / "v.mp4")[1][0][30, 30, 1]) - 188) <= 2


def test_what_makes_no_video_is_refused_and_leaves_no_file(tmp_path):
    image = np.zeros((16, 16, 3), np.uint8)
    with pytest.raises(ValueError, match="must have at least one frame, got none"):
        write_video(tmp_path / "v.mp4", [], 5)
    with pytest.raises(ValueError, match="all frames must have one size"):
        write_video(tmp_path / "v.mp4", [image, image[:8]], 5, least=0)
    with pytest.raises(ValueError, match="fps must be positive and finite, got 0"):
        write_video(tmp_path / "v.mp4", [image], 0)
    with pytest.raises(ValueError, match="suffix must be .mp4, got '.gif'"):
        write_video(tmp_path / "v.gif", [image], 5)
    assert not list(tmp_path.iterdir())


def test_a_path_below_a_file_is_refused_by_name(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file/v.mp4: its folder cannot be made"):
        write_video(tmp_path / "file/v.mp4", [np.zeros((16, 16, 3), np.uint8)], 5)
