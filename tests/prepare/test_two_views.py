"""Videos of two views are told, ordinary pictures are not."""

import numpy as np
import pytest
from quads import looking, picture, write_video

from gaussray.capture.errors import CaptureWarning
from gaussray.prepare.sources import find_sources
from gaussray.prepare.two_views import warn_of_two_views


SIZE = (240, 180)


@pytest.fixture(scope="module")
def views(painted):
    """The room from two places side by side."""
    poses = [looking((x, -3.5, 1.8), target=(x, 1.5, 0.8)) for x in (0.0, 0.06)]
    return [picture(pose, painted, size=SIZE) for pose in poses]


@pytest.mark.parametrize(
    ("axis", "how", "first", "second"),
    [
        (1, "two views side by side", "crop=iw/2:ih:0:0 left.mp4", "crop=iw/2:ih:iw/2:0 right.mp4"),
        (0, "two views one above", "crop=iw:ih/2:0:0 upper.mp4", "crop=iw:ih/2:0:ih/2 lower.mp4"),
    ],
)
def test_two_views_in_a_picture_are_told_with_the_cuts(tmp_path, views, axis, how, first, second):
    write_video(tmp_path / "cam a.mp4", [np.concatenate(views, axis)] * 3)
    with pytest.warns(CaptureWarning) as told:
        assert len(find_sources(tmp_path)) == 1
    (text,) = [str(warning.message) for warning in told]
    assert text.startswith(f"{tmp_path / 'cam a.mp4'}: ") and how in text
    assert f"`ffmpeg -i '{tmp_path / 'cam a.mp4'}' -vf {first}`" in text and second in text


def test_narrowed_views_are_told_if_they_are_very_alike_and_widened_again(tmp_path, views):
    narrowed = np.concatenate([views[0][:, ::2]] * 2, axis=1)
    with pytest.warns(CaptureWarning, match=r"crop=iw/2:ih:0:0,scale=2\*iw:ih left.mp4"):
        warn_of_two_views(tmp_path / "a.mp4", narrowed)
    warn_of_two_views(tmp_path / "a.mp4", np.concatenate([v[:, ::2] for v in views], axis=1))


def test_one_view_is_not_taken_for_two(tmp_path, painted, views):
    wide = picture(looking((0, -3.5, 1.8)), painted, size=(480, 180))
    mirrored = np.concatenate([views[0], views[0][:, ::-1]], axis=1)
    rng = np.random.default_rng(0)
    plain = rng.integers(127, 130, (180, 480, 3)).astype(np.uint8)
    # Edges across the cut continue in the other half: a pole, a horizon.
    pole = np.full((480, 240, 3), 90, np.uint8)
    pole[:, 100:130] = 200
    noise = rng.integers(0, 30, (480, 240, 1)).astype(np.uint8)
    horizon = (pole + noise).transpose(1, 0, 2)
    for one in (wide, mirrored, plain, pole + noise, horizon, np.zeros((20, 60, 3), np.uint8)):
        warn_of_two_views(tmp_path / "a.mp4", np.ascontiguousarray(one))
    warn_of_two_views(tmp_path / "a.mp4", views[0])


def test_two_square_views_are_cut_and_not_stretched(tmp_path, views):
    square = np.concatenate([view[:, 30:210] for view in views], axis=1)
    with pytest.warns(CaptureWarning, match="two views side by side") as told:
        warn_of_two_views(tmp_path / "a.mp4", square)
    assert "scale=" not in str(told[0].message)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [(180, 480), (240, 480), (480, 240), (480, 640)])
@pytest.mark.parametrize("period", [12, 20, 33])
def test_tiles_and_bricks_are_not_two_views(tmp_path, size, period):
    rows, columns = np.indices(size)
    noise = np.random.default_rng(0).normal(0, 4, size)
    tiles = np.where((rows % period < period // 8) | (columns % period < period // 8), 60, 190)
    course = rows // (period // 2)
    shifted = columns + course % 2 * (period // 2)
    bricks = np.where((rows % (period // 2) < 1) | (shifted % period < period // 10), 190, 110)
    board = (rows // period + columns // period) % 2 * 150 + 50
    for levels in (tiles, bricks, board):
        grey = (levels + noise).clip(0, 255).astype(np.uint8)
        warn_of_two_views(tmp_path / "a.mp4", np.repeat(grey[..., None], 3, axis=2))
