"""Points of what moves in one picture alone: where what stands still beside it is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from gaussray import Camera, Pinhole
from gaussray.camera.camera import project
from gaussray.reconstruct.initialize.stereo.neighbour_depth import points_beside
from gaussray.reconstruct.initialize.stereo.views import stereo_views


SIDE = 32
WALL, POST = 5.0, 2.0
# Colours are packed into 1023 levels; pixels are computed in single precision.
LEVEL, PIXEL = 1e-3, 1e-3


@pytest.fixture(scope="module")
def filmed():
    """A camera at the origin, its random picture, and the view of it."""
    camera = Camera((SIDE, SIDE), Pinhole(20.0, (SIDE / 2, SIDE / 2)))
    picture = np.random.default_rng(0).random((SIDE, SIDE, 3)).astype(np.float32)
    stacked = jax.tree.map(lambda x: jnp.asarray(x)[None], camera)
    return camera, picture, stereo_views(picture[None], stacked, None, factor=1)[0]


def room():
    """A wall, and a post before it that ends at row 20."""
    distance = np.full((SIDE, SIDE), WALL)
    distance[20:, 12:20] = POST
    return distance


def moving(rows, columns):
    mask = np.zeros((SIDE, SIDE), bool)
    mask[rows, columns] = True
    return mask


def test_what_stands_on_a_post_is_as_far_away_as_the_post(filmed):
    camera, picture, view = filmed
    mask = moving(slice(8, 20), slice(13, 19))
    points = points_beside(view, mask, room())
    assert_allclose(np.linalg.norm(points.position, axis=1), POST, rtol=1e-5)
    pixel = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, jnp.asarray(points.position)))
    row, column = np.nonzero(mask)
    assert_allclose(pixel, np.stack([column, row], axis=1) + 0.5, atol=PIXEL)
    assert_allclose(points.color, picture[mask], atol=LEVEL)


def test_each_group_has_a_distance_of_its_own_and_nothing_is_behind_what_stands_still(filmed):
    _, _, view = filmed
    mask = moving(slice(8, 20), slice(13, 19)) | moving(slice(2, 6), slice(24, 30))
    distance = room()
    distance[10, 15] = 1.0
    away = np.linalg.norm(points_beside(view, mask, distance).position, axis=1)
    expected = np.where(np.nonzero(mask)[1] >= 24, WALL, POST)
    expected[(np.nonzero(mask)[0] == 10) & (np.nonzero(mask)[1] == 15)] = 1.0
    assert_allclose(away, expected, rtol=1e-5)


def test_before_a_plain_backdrop_what_moves_is_as_far_away_as_what_is_in_its_place(filmed):
    _, _, view = filmed
    distance = np.full((SIDE, SIDE), np.inf)
    distance[10:14, 14:17] = WALL
    points = points_beside(view, moving(slice(8, 20), slice(13, 19)), distance)
    assert len(points.position) == 12 * 6
    assert_allclose(np.linalg.norm(points.position, axis=1), WALL, rtol=1e-5)


def test_specks_and_what_has_nothing_beside_it_get_no_points(filmed):
    _, _, view = filmed
    assert not len(points_beside(view, moving([5, 9], [5, 20]), room()).position)
    alone = moving(slice(8, 20), slice(13, 19))
    assert not len(points_beside(view, alone, np.full((SIDE, SIDE), np.inf)).position)
    assert not len(points_beside(view, np.zeros((SIDE, SIDE), bool), room()).position)
