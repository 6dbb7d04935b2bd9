"""The cross-view check: true surfaces are confirmed, planted outliers are not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from textured_plane import (
    NORMAL,
    OFFSET,
    PLACES,
    perspective,
    rig,
    seen,
)

from gaussray.reconstruct.initialize.stereo.consistency import agreement
from gaussray.reconstruct.initialize.stereo.views import rays, stereo_views


# Of a distance that was averaged over the views, against the plane.
MEAN = 0.01
PIXEL = (22, 25)


@pytest.fixture(scope="module")
def views():
    cameras = rig(perspective(), PLACES)
    return stereo_views(seen(cameras), cameras, None, factor=1)


def plane_map(views, i):
    """Ray map and inverse distances of the plane in one view."""
    lens = jax.tree.map(lambda x: x[i], views.lens)
    ray = rays(lens, views.world_from_camera[i], views.size, 1)
    along = np.einsum("i,ihw->hw", NORMAL, np.asarray(ray))
    return ray, along / (OFFSET - np.asarray(views.origin[i]) @ NORMAL)


def checked(views, inverse):
    others = np.array([1, 2, 3, 4])
    maps = jnp.asarray(np.stack([plane_map(views, j)[1] for j in others]))
    ray, _ = plane_map(views, 0)
    step = jnp.asarray(0.01)
    return jax.jit(agreement)(views[0], ray, jnp.asarray(inverse), views[others], maps, step)


def test_a_surface_that_all_views_hold_is_confirmed_by_all(views):
    _, inverse = plane_map(views, 0)
    result = checked(views, inverse)
    assert result.confirmed[PIXEL] == 4 and result.crossed[PIXEL] == 0
    middle = np.s_[12:36, 12:36]
    assert np.abs(np.asarray(result.inverse) / inverse - 1)[middle].max() < MEAN


def test_a_planted_outlier_is_not_confirmed(views):
    _, inverse = plane_map(views, 0)
    planted = inverse.copy()
    planted[PIXEL] *= 1.4
    result = checked(views, planted)
    assert result.confirmed[PIXEL] == 0
    # It floats in front of what the others see behind it.
    assert result.crossed[PIXEL] >= 3
    assert result.confirmed[PIXEL[0], PIXEL[1] + 1] == 4


def test_what_lies_behind_a_surface_is_hidden_not_crossed(views):
    _, inverse = plane_map(views, 0)
    result = checked(views, inverse * 0.8)
    assert result.confirmed[PIXEL] == 0 and result.crossed[PIXEL] == 0


def test_pixels_without_distance_are_confirmed_by_none(views):
    result = checked(views, np.zeros(views.size))
    assert not result.confirmed.any() and not result.crossed.any()
