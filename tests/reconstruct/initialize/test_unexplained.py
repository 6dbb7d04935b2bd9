"""What moves where cameras move: pixels that Gaussians which stand still do not show."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.camera import project
from gaussray.color import srgb_decode, srgb_encode
from gaussray.dataset.images import srgb_levels
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import cut, tile_pixels
from gaussray.reconstruct.initialize.unexplained import UnexplainedPixels
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer


SIZE, SIDE = 60, 8
# A camera that goes around the scene in the times of its frames.
ANGLES, TIMES = (-0.3, -0.1, 0.1, 0.3), (0.0, 0.25, 0.5, 1.0)
# Share of the pixels that differ by motion, at least, and share of those found that do not, at
# most: differences are averaged over 5 x 5 pixels.
FOUND, WRONG = 0.7, 0.3


@pytest.fixture(scope="module")
def filmed():
    """Footage of the toy by a camera that moves, and the pixels that the bodies change."""
    cameras = [toy.camera(a, t, SIZE, SIZE) for a, t in zip(ANGLES, TIMES, strict=True)]
    whole = toy.scene()
    wall = replace(whole, moving=jax.tree.map(lambda x: x[:0], whole.moving), deformation=None)
    pictures, empty = (
        [srgb_levels(render(camera).color) for camera in cameras]
        for render in (
            Renderer(s, options=RenderOptions(samples=1), trace=toy.TRACE) for s in (whole, wall)
        )
    )
    pixels = tile_pixels(cameras[0].film, SIDE, SIDE)
    tiles = np.stack([cut(picture, pixels) for picture in pictures])
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *cameras)
    footage = Footage(tiles, None, stacked, np.array(["a"] * 4), SIDE, SIDE)
    apart = np.abs(np.float32(pictures) - np.float32(empty)).max(axis=-1) > 0.1 * 255
    return footage, wall, apart


def unexplained(footage, wall, gain=None):
    """What the wall alone does not explain."""
    return UnexplainedPixels(footage, footage.camera, gain, wall.static, toy.TRACE)


def test_bodies_before_a_wall_are_what_moves(filmed):
    footage, wall, apart = filmed
    masks = unexplained(footage, wall)
    for frame in range(len(ANGLES)):
        moved = masks(frame)
        both = (moved & apart[frame]).sum()
        assert both > FOUND * apart[frame].sum() and moved.sum() - both < WRONG * moved.sum()


def test_frames_that_were_not_asked_for_have_the_counts_of_the_nearest(filmed):
    footage, wall, _ = filmed
    masks = unexplained(footage, wall)
    assert not masks.tile_counts().any()
    first, last = masks(0), masks(3)
    counts = masks.tile_counts()
    pixels = tile_pixels(footage.film, SIDE, SIDE)
    np.testing.assert_array_equal(counts[0], cut(first, pixels).sum(axis=-1))
    np.testing.assert_array_equal(counts[1], counts[0])
    np.testing.assert_array_equal(counts[2], counts[0])
    np.testing.assert_array_equal(counts[3], cut(last, pixels).sum(axis=-1))


def test_exposure_is_no_motion(filmed):
    footage, wall, apart = filmed
    exposure = 0.5
    light = exposure * srgb_decode(footage.pixel / 255)
    dark = replace(footage, pixel=(255 * srgb_encode(light) + 0.5).astype(np.uint8))

    def agreement(seen, gain):
        moved = unexplained(seen, wall, gain)(1)
        return (moved & apart[1]).sum() / (moved | apart[1]).sum()

    # Differences are smaller in the dark, so that fewer pixels exceed the threshold.
    known = agreement(dark, jnp.full((4, 3), exposure))
    assert agreement(footage, None) > known > 0.75 and agreement(dark, None) < 0.5


def test_nothing_moves_in_a_picture_that_differs_everywhere(filmed):
    """What stands still is not shown yet: that says nothing of motion."""
    footage, wall, _ = filmed
    assert not unexplained(replace(footage, pixel=np.zeros_like(footage.pixel)), wall)(1).any()


def test_masked_pixels_do_not_move(filmed):
    footage, wall, _ = filmed
    mask = np.zeros((*footage.pixel.shape[:2], SIDE * SIDE // 8), np.uint8)
    assert not unexplained(replace(footage, mask=mask), wall)(1).any()


def test_mask_and_points_of_a_frame_are_of_one_rendering(filmed, monkeypatch):
    footage, wall, _ = filmed
    masks, rendered = unexplained(footage, wall), []
    render = UnexplainedPixels._rendered
    monkeypatch.setattr(
        UnexplainedPixels, "_rendered", lambda self, view: rendered.append(1) or render(self, view)
    )
    first = masks(1)
    assert len(masks.points(1).position) and np.array_equal(masks(1), first) and len(rendered) == 1
    assert not np.array_equal(masks(3), first) and len(rendered) == 2


def test_what_one_picture_alone_shows_is_as_far_away_as_the_wall_beside_it(filmed):
    footage, wall, apart = filmed
    masks, frame = unexplained(footage, wall), 1
    position = masks.points(frame).position
    camera = jax.tree.map(lambda x: x[frame], footage.camera)
    pixel = jax.vmap(project, in_axes=(None, 0))(camera, jnp.asarray(position))
    column, row = np.asarray(pixel).astype(int).T
    assert len(position) > FOUND * apart[frame].sum()
    assert apart[frame][row, column].mean() > 1 - WRONG
    eye = np.asarray(camera.trajectory.translation)[0]
    nearest, farthest = (
        f(np.linalg.norm(np.asarray(wall.static.mean) - eye, axis=1)) for f in (np.min, np.max)
    )
    away = np.linalg.norm(position - eye, axis=1)
    assert np.all((away > 0.9 * nearest) & (away < farthest))
