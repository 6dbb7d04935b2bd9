"""The matching cost of one pixel, against loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from textured_plane import (
    NORMAL,
    OFFSET,
    PLACES,
    QUICK,
    perspective,
    rig,
    seen,
)

from gaussray.reconstruct.initialize.stereo.cost import best_half, misses, window
from gaussray.reconstruct.initialize.stereo.pixel_list import pixel_list
from gaussray.reconstruct.initialize.stereo.refine import _Patch
from gaussray.reconstruct.initialize.stereo.sweep import _level_cost, windowed
from gaussray.reconstruct.initialize.stereo.views import rays, stereo_views, unpacked


# Sums of 25 products in double precision, in another order; variances are differences of them.
LOOPS = 1e-9
PIXEL = (20, 27)


@pytest.fixture(scope="module")
def views():
    cameras = rig(perspective(), PLACES)
    return stereo_views(seen(cameras), cameras, None, factor=1)


def ray_map(views, i):
    return rays(jax.tree.map(lambda x: x[i], views.lens), views.world_from_camera[i], views.size, 1)


def bilinear(picture, x, y):
    left, top = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
    fx, fy = x - 0.5 - left, y - 0.5 - top
    upper = (1 - fx) * picture[:, top, left] + fx * picture[:, top, left + 1]
    lower = (1 - fx) * picture[:, top + 1, left] + fx * picture[:, top + 1, left + 1]
    return (1 - fy) * upper + fy * lower


def place_in(views, j, point):
    local = np.asarray(views.world_from_camera[j]).T @ (point - np.asarray(views.origin[j]))
    lens = jax.tree.map(lambda x: x[j], views.lens)
    return np.asarray(lens.project(jnp.asarray(local)))


def cost_of(own, other):
    """Cost of two lists of colours [taps, 3]."""
    e = 3 * QUICK.noise**2
    a, b = own - own.mean(axis=0), other - other.mean(axis=0)
    covariance = (a * b).sum(axis=1).mean()
    variance = [(x * x).sum(axis=1).mean() + e for x in (a, b)]
    zncc = (covariance + e / 2) / np.sqrt(variance[0] * variance[1])
    difference = min(np.abs(own - other).mean() / QUICK.color, 1)
    return np.clip(QUICK.zncc * (1 - zncc) + (1 - QUICK.zncc) * difference, 0, 1)


def pictures_of(views):
    color, _ = unpacked(views.pixel, jnp.float64)
    return np.stack([np.asarray(c) for c in color], axis=1)


def test_the_sweep_costs_a_pixel_what_loops_over_its_window_do(views):
    inverse, (row, column) = 0.31, PIXEL
    ray, near = ray_map(views, 0), views[np.array([1, 2, 3, 4])]
    own = views[0]
    reference, _ = unpacked(own.pixel, ray.dtype)
    means = jax.tree.map(lambda value: windowed(value, QUICK.radius), window(reference))

    @jax.jit
    def level_cost(ray):
        return _level_cost(own, ray, near, reference, means, inverse + 0 * ray[0], QUICK)

    cost = level_cost(ray)
    pictures, taps = pictures_of(views), [(a, b) for a in range(-2, 3) for b in range(-2, 3)]
    costs = []
    for j in range(1, 5):
        here, there = [], []
        for a, b in taps:
            point = np.asarray(views.origin[0]) + np.asarray(ray[:, row + a, column + b]) / inverse
            here.append(pictures[0][:, row + a, column + b])
            there.append(bilinear(pictures[j], *place_in(views, j, point)))
        costs.append(cost_of(np.array(here), np.array(there)))
    assert abs(float(cost[row, column]) - np.mean(sorted(costs)[:2])) < LOOPS


def test_refinement_costs_a_pixel_what_loops_over_its_window_do(views):
    (row, column), ray = PIXEL, ray_map(views, 0)
    own, near = views[0], views[np.array([1, 2, 3, 4])]
    origin = np.asarray(own.origin)
    distance = (OFFSET - origin @ NORMAL) / np.einsum("i,ihw->hw", NORMAL, np.asarray(ray))
    normal = jnp.broadcast_to(-jnp.asarray(NORMAL)[:, None], (3, distance.size))
    # All pixels, in one part.
    pixels = pixel_list(jnp.ones(own.size, bool), jnp.asarray(1), distance.size)
    cost = jax.jit(
        lambda d, n: _Patch(own, ray, near, pixels, QUICK).cost(jnp.asarray(0), 1 / d, n)
    )(jnp.asarray(distance.ravel()), normal).reshape(own.size)
    pictures = pictures_of(views)
    rays_at = np.asarray(ray)
    middle = rays_at[:, row, column]
    right = middle + (rays_at[:, row, column + 1] - rays_at[:, row, column - 1]) / 2
    down = middle + (rays_at[:, row + 1, column] - rays_at[:, row - 1, column]) / 2
    on_plane = [
        origin + r * distance[row, column] * (NORMAL @ middle) / (NORMAL @ r)
        for r in (middle, right, down)
    ]
    taps = [(a, b) for a in range(-2, 3) for b in range(-2, 3) if (a + b) % 2 == 0]
    costs = []
    for j in range(1, 5):
        at, beside, below = (place_in(views, j, point) for point in on_plane)
        places = [at + b * (beside - at) + a * (below - at) for a, b in taps]
        here = [pictures[0][:, row + a, column + b] for a, b in taps]
        there = [bilinear(pictures[j], *place) for place in places]
        costs.append(cost_of(np.array(here), np.array(there)))
    assert abs(float(cost[row, column]) - np.mean(sorted(costs)[:2])) < LOOPS


def test_the_better_half_of_the_views_that_see_a_point_counts():
    cost = jnp.asarray([0.9, 0.1, 0.3, 0.2, 0.5])
    sees = jnp.asarray([True, True, True, False, True])
    assert np.isclose(best_half(cost, sees), (0.1 + 0.3) / 2)
    # One view alone counts half, none nothing.
    assert np.isclose(best_half(cost, jnp.arange(5) == 1), (0.1 + 1) / 2)
    assert np.isclose(best_half(cost, jnp.zeros(5, bool)), 1)


def test_equal_costs_count_once_each():
    assert np.isclose(best_half(jnp.full(4, 0.25), jnp.ones(4, bool)), 0.25)


def test_silhouettes_vote_from_the_second_view_on_that_misses():
    cost, sees = jnp.asarray(0.2), jnp.asarray([True, True, True, False])
    for hit, expected in (([1, 1, 1, 1], 0.2), ([0, 1, 1, 0], 0.2), ([0, 0, 0, 0], 0.44)):
        assert np.isclose(misses(cost, sees, jnp.asarray(hit, bool), 0.12), expected)


def test_windows_are_means_with_repeated_borders():
    value = np.random.default_rng(0).random((7, 9))
    padded = np.pad(value, 2, mode="edge")
    expected = [[padded[i : i + 5, j : j + 5].mean() for j in range(9)] for i in range(7)]
    assert np.allclose(windowed(jnp.asarray(value), 2), expected)
