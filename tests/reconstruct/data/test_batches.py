"""What a step looks at: the rays of its tiles, their colours and weights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.camera import camera_rays
from gaussray.camera.film import Film
from gaussray.reconstruct.data.batches import gather, tile_colors, tile_rays
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import cut, tile_pixels


# Odd sides that tiles of SIDE do not divide: 2 x 3 tiles.
WIDTH, HEIGHT, SIDE = 13, 19, 8
TILES = 6
# Cameras one by one or stacked, codes over 255: a few roundings of single precision.
SAME = 1e-6

CAMERAS = [toy.camera(0.2 * i, time, WIDTH, HEIGHT) for i, time in enumerate((0.0, 0.5, 1.0))]

MIDDLE = jnp.full((1, 5), 0.5)

cast = jax.jit(tile_rays, static_argnames=("side", "bundle"))
rays_of, colors_of = jax.jit(camera_rays), jax.jit(jax.vmap(tile_colors))


def picture(frame):
    """Codes that name their own column, row and frame."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([x, y, np.full_like(x, frame)], axis=-1).astype(np.uint8)


def hole():
    """A mask that is False in one corner and at one pixel."""
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[:5, :7] = mask[17, 3] = False
    return mask


def filmed(masked=True, dtype=np.uint8):
    """Three frames of a camera that moves; the one in the middle may have a mask."""
    camera = jax.tree.map(lambda *x: jnp.stack(x), *CAMERAS)
    pixels = tile_pixels(camera.film, SIDE)
    pixel = np.stack([cut(picture(i), pixels) for i in range(3)])
    if dtype != np.uint8:
        pixel = (pixel / 255).astype(dtype)
    all_of = np.ones((HEIGHT, WIDTH), bool)
    masks = [cut(m, pixels) for m in (all_of, hole(), all_of)]
    mask = np.packbits(masks, axis=-1) if masked else None
    return Footage(pixel, mask, camera, np.array(["a"] * 3), SIDE)


def gathered(footage):
    """All tiles of all frames, a step per frame."""
    frame, tile = np.mgrid[:3, :TILES].astype(np.int32)
    return gather(footage, frame, tile, footage.times)


@pytest.fixture(scope="module")
def batch():
    return gathered(filmed())


@pytest.fixture(scope="module")
def seen(batch):
    """Encoded colours and weights of all tiles of all frames, a frame after the other."""
    return jax.tree.map(np.asarray, colors_of(batch))


def places(color):
    """Frame, row and column of the pixels, which their colours name."""
    x, y, frame = np.rint(255 * np.moveaxis(color, -1, 0)).astype(int)
    return frame, y, x


def test_colours_are_those_of_the_tiles_drawn(seen):
    color, _ = seen
    pixels = tile_pixels(CAMERAS[0].film, SIDE)
    expected = np.stack([cut(picture(i), pixels).reshape(-1, 3) for i in range(3)]) / 255
    np.testing.assert_allclose(color, expected, atol=SAME)


def test_rays_are_those_of_the_pixels_centres_and_of_their_own_frame(batch, seen):
    color, _ = seen
    views = filmed().camera
    middle = jnp.full((color.shape[1], 5), 0.5, jnp.float32)
    for own, camera in enumerate(CAMERAS):
        stack = jax.tree.map(lambda x, own=own: x[batch.frame[own]], views)
        rays = cast(stack, batch.tile[own], MIDDLE, side=SIDE)
        frame, y, x = places(color[own])
        assert (frame == own).all()
        expected = rays_of(camera, toy.single(np.stack([x, y], axis=-1)), middle)
        for name in ("origin", "direction", "time"):
            found = getattr(rays, name)[0]
            np.testing.assert_allclose(found, getattr(expected, name), atol=SAME, err_msg=name)


def test_every_sample_has_the_rays_that_its_numbers_mean():
    lens, film = toy.rolling(CAMERAS[1]), Film(WIDTH, HEIGHT)
    camera = type(lens)(**(vars(lens) | {"film": film}))
    u = toy.single(np.random.default_rng(0).random((3, 5)))
    stack = jax.tree.map(lambda x: jnp.stack([x, x]), camera)
    rays = cast(stack, jnp.array([0, 5], jnp.int32), u, side=SIDE)
    assert rays.time.shape == (3, 2 * SIDE**2)
    y, x = np.mgrid[:SIDE, :SIDE]
    for tile, (left, top) in enumerate([(0, 0), (WIDTH - SIDE, HEIGHT - SIDE)]):
        pixel = toy.single(np.stack([x + left, y + top], axis=-1).reshape(-1, 2))
        for i in range(3):
            expected = rays_of(camera, pixel, jnp.broadcast_to(u[i], (SIDE**2, 5)))
            for name in ("origin", "direction", "time"):
                found = getattr(rays, name)[i].reshape(2, SIDE**2, -1)[tile]
                wanted = getattr(expected, name).reshape(SIDE**2, -1)
                np.testing.assert_allclose(found, wanted, atol=SAME, err_msg=name)


def test_what_is_masked_has_weight_0_and_all_else_weight_1(seen):
    color, weight = seen
    for own in range(3):
        _, y, x = places(color[own])
        expected = hole()[y, x] if own == 1 else np.ones(len(x))
        np.testing.assert_array_equal(weight[own], expected)
    assert (weight[1] == 0).any() and (weight[1] == 1).any()


def test_without_masks_every_weight_is_1():
    found = gathered(filmed(masked=False))
    assert found.visible is None
    assert (tile_colors(jax.tree.map(lambda x: x[0], found))[1] == 1).all()


def test_pictures_of_fractions_are_taken_as_they_are(seen):
    found = colors_of(gathered(filmed(dtype=np.float32)))
    np.testing.assert_allclose(found[0], seen[0], atol=SAME)


def test_rays_of_large_tiles_come_in_the_order_of_their_pixels():
    camera = toy.camera(0.2, 0.0, 37, 50)
    stack = jax.tree.map(lambda x: jnp.stack([x] * 2), camera)
    rays = cast(stack, jnp.array([0, 3], jnp.int32), MIDDLE, side=16, bundle=8)
    pixels = tile_pixels(camera.film, 16, 8)[[0, 3]].reshape(-1)
    place = jnp.stack([pixels % 37, pixels // 37], axis=-1).astype(jnp.float32)
    expected = rays_of(camera, place, jnp.full((len(place), 5), 0.5, jnp.float32))
    np.testing.assert_allclose(rays.direction[0], expected.direction, atol=SAME)
