"""Where pictures change: tiles and points."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.temporal_median import MOTION_THRESHOLD
from gaussray.reconstruct.data import motion_mask as module
from gaussray.reconstruct.data.motion_mask import activity, moved_pixels, point_activity
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import cut, tile_pixels


SIZE, SIDE = 12, 8
# A point whose pixel is in the corner, one in the middle, one behind the camera.
PLACE = np.array([[-1.2, -1.2, 0], [0.5, 0.5, 0], [0, 0, -99]], np.float32)


def filmed(picture, mask=None, name="a"):
    """Footage of a camera that stands still."""
    times = np.arange(len(picture)) if isinstance(name, str) else np.arange(len(picture)) // 2
    cameras = [toy.camera(time=float(t), width=SIZE, height=SIZE) for t in times]
    camera = jax.tree.map(lambda *x: jnp.stack(x), *cameras)
    pixels = tile_pixels(camera.film, SIDE)
    packed = None
    if mask is not None:
        packed = np.stack([np.packbits(cut(m, pixels), axis=-1) for m in mask])
    names = np.broadcast_to(np.array(name), len(picture))
    return Footage(np.stack([cut(p, pixels) for p in picture]), packed, camera, names, SIDE)


@pytest.fixture
def picture():
    """A black picture with a white 4 x 4 corner at the last of four instants."""
    picture = np.zeros((4, SIZE, SIZE, 3), np.uint8)
    picture[3, :4, :4] = 255
    return picture


def test_activity_counts_the_pixels_that_leave_the_median(picture):
    footage = filmed(picture)
    found = activity(footage)
    # Tiles at 0 and 4: the second ones overlap the first and meet the corner nowhere.
    np.testing.assert_array_equal(found.moved, [[0] * 4] * 3 + [[16, 0, 0, 0]])
    np.testing.assert_array_equal(
        moved_pixels(footage, found, np.array([3, 0])), picture[[3, 0], ..., 0] > 0
    )


@pytest.mark.parametrize("bytes_of", [np.uint8, np.float32])
@pytest.mark.parametrize("piece", [1, 1 << 24])
def test_two_cameras_masks_and_pieces_agree_with_brute_force(monkeypatch, bytes_of, piece):
    monkeypatch.setattr(module, "PIECE", piece)
    dice = np.random.default_rng(0)
    # Codes far enough from each other that none differs by just the threshold.
    codes = 30 * dice.integers(8, size=(10, SIZE, SIZE, 3))
    mask = dice.random((10, SIZE, SIZE)) < 0.6
    mask[::2, 5, 5] = False
    name = np.array(["a", "b"] * 5)
    scale = 1 if bytes_of == np.uint8 else 255
    footage = filmed((codes / scale).astype(bytes_of), mask, name)
    expected = np.zeros(mask.shape, bool)
    for camera in "ab":
        own = np.flatnonzero(name == camera)
        seen = np.where(mask[own, ..., None], codes[own] / 255, np.nan)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a pixel that is never visible
            median = np.nanmedian(seen, axis=0)
        expected[own] = (np.abs(codes[own] / 255 - median) > MOTION_THRESHOLD).any(axis=-1)
    found = activity(footage)
    np.testing.assert_array_equal(moved_pixels(footage, found, np.arange(10)), expected)
    pixels = tile_pixels(footage.film, SIDE)
    counts = [cut(m, pixels).sum(axis=1) for m in expected & mask]
    np.testing.assert_array_equal(found.moved, counts)


def test_a_point_is_as_active_as_its_pixel(picture):
    np.testing.assert_allclose(point_activity(filmed(picture), PLACE), [0.25, 0, 0])


def test_a_camera_that_moves_does_not_tell_whether_a_point_is_active(picture):
    """Five cameras move, each picture from a place of its own, beside one that stands still."""
    alone = filmed(picture)
    cameras, names = [alone.camera], [alone.name]
    for k in range(1, 6):
        shift = (4 * k + jnp.arange(4))[:, None, None] * jnp.array([[[0.01, 0, 0]]])
        camera = eqx.tree_at(
            lambda c: c.trajectory.translation, alone.camera, replace_fn=lambda x, s=shift: x + s
        )
        cameras.append(camera)
        names.append(np.full(4, f"moving{k}"))
    footage = Footage(
        np.tile(alone.pixel, (6, 1, 1, 1)),
        None,
        jax.tree.map(lambda *x: jnp.concatenate(x), *cameras),
        np.concatenate(names),
        SIDE,
        viewpoint=np.concatenate([np.zeros(4, int), np.arange(1, 21)]),
    )
    np.testing.assert_allclose(point_activity(footage, PLACE), [0.25, 0, 0])


def test_masked_pixels_do_not_make_a_point_active(picture):
    picture[1] = 255
    mask = np.ones(picture.shape[:3], bool)
    mask[1] = False
    # Of the three pictures that count, one differs in the corner.
    np.testing.assert_allclose(point_activity(filmed(picture, mask), PLACE), [1 / 3, 0, 0])
    mask[0, :4, :4] = False
    assert (point_activity(filmed(picture, mask), PLACE) == 0).all()
