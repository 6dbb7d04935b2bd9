"""Tiles cover a picture, bounds hold their rays, and coherent order brings neighbours together."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import Lines, rays, shot

from gaussray.tracer.bundle import (
    FAN,
    bound_bundles,
    coherent_order,
    fill_padding,
    morton,
    morton_tiles,
)


# Points on rays against planes of single precision, relative to their distance.
ROUNDING = 1e-6


@pytest.mark.parametrize("picture", [(8, 8, 8, 0), (37, 21, 4, 1), (70, 65, 4, 2), (1, 1, 8, 1)])
def test_tiles_cover_each_pixel_once(picture):
    width, height, side, levels = picture
    index = morton_tiles(width, height, side, levels)
    assert len(index) % (side**2 * FAN**levels) == 0
    np.testing.assert_array_equal(np.sort(index[index >= 0]), np.arange(width * height))


@pytest.mark.parametrize("level", [0, 1, 2])
def test_tiles_of_every_level_are_square_blocks(level):
    width, height, side = 128, 64, 2
    index = morton_tiles(width, height, side, 2).reshape(-1, side**2 * FAN**level)
    x, y = index % width, index // width
    span = side * 4**level
    for c in (x, y):
        assert np.all(np.max(c, axis=1) - np.min(c, axis=1) == span - 1)
        assert np.all(np.min(c, axis=1) % span == 0)


@pytest.mark.parametrize("picture", [(37, 21, 4, 1), (70, 65, 4, 2), (3, 1, 8, 1), (16, 17, 8, 0)])
def test_padding_is_in_the_bundle_that_it_fills(picture):
    """A far pixel would widen the bounds of its bundle over half the picture."""
    width, height, side, levels = picture
    order = morton_tiles(width, height, side, levels)
    filled = fill_padding(order)
    np.testing.assert_array_equal(filled[order >= 0], order[order >= 0])
    for level in range(levels + 1):
        across = side * 4**level
        block = (filled // width // across) * width + filled % width // across
        block = block.reshape(-1, across**2)
        some = np.any(order.reshape(-1, across**2) >= 0, axis=1)
        assert np.all(block[some] == block[some, :1])


def holds(bundles, lines, distance):
    """Whether the points at a distance along the rays are inside of their bundle's half-spaces."""
    point = lines.origin + distance * lines.direction
    normal, offset = (np.asarray(x, np.float64) for x in (bundles.normal, bundles.offset))
    along = np.einsum("bsi,bri->bsr", normal, point)
    return np.all(along >= offset[..., None] - ROUNDING * distance)


@pytest.mark.parametrize("spread", [0.01, 0.5, 3.0])
@pytest.mark.parametrize("jitter", [0.0, 1.0])
def test_every_point_of_every_ray_is_inside(spread, jitter):
    lines = Lines(*(x.reshape(4, 16, *x.shape[1:]) for x in rays(spread=spread, jitter=jitter)))
    bundles = jax.jit(bound_bundles)(shot(lines), jnp.zeros(1, jnp.float32))
    assert all(holds(bundles, lines, distance) for distance in (0.0, 1e-3, 1.0, 1e4))
    if spread < 1:
        assert np.all(np.any(np.asarray(bundles.normal) != 0, axis=-1))


def test_a_bundle_without_rays_holds_nothing_and_broken_rays_do_not_count():
    lines = Lines(*(x.reshape(4, 16, *x.shape[1:]).copy() for x in rays()))
    lines.direction[0] = 0
    lines.origin[1, 3] = np.nan
    lines.direction[2, :8] = 0
    lines.time[3, 5] = np.inf
    bundles = jax.jit(bound_bundles)(shot(lines), jnp.array([0.0, 0.5, 1.0], jnp.float32))
    assert np.all(np.isposinf(bundles.offset[0]))
    assert np.all(np.isfinite(bundles.offset[1:])) and np.all(np.isfinite(bundles.normal))
    good = Lines(*(x[2:3, 8:] for x in lines))
    part = jax.tree.map(lambda x: x[2:3], bundles)
    assert holds(part, good, 1.0)
    assert np.all(np.any(np.asarray(bundles.active[1:]), axis=1))


def test_coherent_order_is_a_permutation_that_gathers_neighbours():
    r = np.random.default_rng(0)
    way = r.normal(size=(8, 3))
    which = r.integers(0, 8, 256)
    direction = way[which] + 0.01 * r.normal(size=(256, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    lines = Lines(np.zeros((256, 3)), direction, np.zeros(256))
    order = np.asarray(jax.jit(coherent_order)(shot(lines)))
    assert sorted(order) == list(range(256))
    changes = np.sum(np.diff(which[order]) != 0)
    # Eight clusters could be gathered with seven changes; some straddle a cell of the sort.
    assert changes < 40 < np.sum(np.diff(which) != 0)


def test_morton_code_interleaves_bits():
    cell = jnp.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [3, 0, 0], [1023, 1023, 1023]], jnp.int32)
    np.testing.assert_array_equal(morton(cell), [1, 2, 4, 9, 2**30 - 1])
