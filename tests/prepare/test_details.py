"""Pictures that show nothing are refused before anything is matched."""

import numpy as np
import pytest
from quads import looking, picture, write_video

from gaussray.dataset.images import write_image
from gaussray.prepare.details import check_details
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import find_sources


def dotted(at):
    """A marker on black, as infra-red cameras record it."""
    levels = np.zeros((180, 240, 3), np.uint8)
    levels[80:92, at : at + 12] = 255
    return levels


@pytest.mark.parametrize(
    ("shown", "what"),
    [(dotted, "spots on an even ground"), (lambda _: dotted(999), "an even colour")],
)
def test_videos_of_nothing_are_refused(tmp_path, shown, what):
    for name in "ab":
        write_video(tmp_path / f"{name}.mp4", [shown(20 + 3 * k) for k in range(12)])
    with pytest.raises(
        PrepareError, match=f"all 2 cameras' pictures show {what}.*calibration=FILE"
    ):
        check_details(find_sources(tmp_path))


def test_pictures_of_nothing_are_refused(tmp_path):
    for k in range(4):
        write_image(tmp_path / f"{k}.png", dotted(20 + k))
    with pytest.raises(PrepareError, match="the camera's pictures show spots"):
        check_details(find_sources(tmp_path))


def test_one_camera_that_shows_something_is_enough(tmp_path, painted):
    scene = picture(looking((0, -3.5, 1.8)), painted, size=(240, 180))
    write_video(tmp_path / "a.mp4", [dotted(20)] * 12)
    write_video(tmp_path / "b.mp4", [scene] * 12)
    check_details(find_sources(tmp_path))
    # A film that begins black.
    write_video(tmp_path / "b.mp4", [dotted(20)] * 10 + [scene] * 2)
    check_details(find_sources(tmp_path))
    # A dark scene, as a night recording.
    write_video(tmp_path / "b.mp4", [scene // 6] * 12)
    check_details(find_sources(tmp_path))


@pytest.mark.parametrize("channel", range(3))
def test_texture_of_any_colour_is_texture(tmp_path, channel):
    levels = np.zeros((120, 160, 3), np.uint8)
    levels[..., channel] = np.random.default_rng(0).integers(0, 256, (120, 160))
    write_image(tmp_path / "0.png", levels)
    write_image(tmp_path / "1.png", levels)
    check_details(find_sources(tmp_path))
