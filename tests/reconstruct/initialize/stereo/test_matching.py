"""Stereo of a textured plane that synthetic cameras see: closed form, and the laws that any scene
obeys."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree
from textured_plane import (
    NORMAL,
    OFFSET,
    PLACES,
    QUICK,
    fisheye,
    perspective,
    rig,
    seen,
    texture,
)

from gaussray.geometry import quaternion, rotation_matrix, turning
from gaussray.reconstruct.initialize.stereo.matching import reduction, stereo_points
from gaussray.reconstruct.initialize.stereo.subsample import evenly


pytestmark = pytest.mark.usefixtures("optimized_programs")

# Distance from the plane in units of length: a pixel is 0.057 wide there, and spans 0.24 in depth
# between neighbours 0.7 apart.
DEPTH, DEPTH_MOST = 0.03, 0.15
# Colours of points lie between those of the pixels that were averaged.
COLOR = 0.1
# Of the pixels that see the plane and are seen by two others.
SHARE = 0.4
# Places of the same points from the same numbers, rounded in another order.
SAME = 1e-6


@pytest.fixture(scope="module")
def pinhole_points():
    cameras = rig(perspective(), PLACES)
    return stereo_points(seen(cameras), cameras, options=QUICK)


def off_plane(position):
    return np.abs(position @ NORMAL - OFFSET)


def test_points_of_a_plane_lie_on_it_with_its_normal_and_colours(pinhole_points):
    points = pinhole_points
    assert len(points.position) > SHARE * len(PLACES) * 48**2
    error = off_plane(points.position)
    assert np.median(error) < DEPTH and np.quantile(error, 0.95) < DEPTH_MOST
    assert np.median(np.abs(texture(points.position) - points.color)) < COLOR
    assert np.median(np.abs(points.normal @ NORMAL)) > np.cos(np.radians(20))
    assert np.all((points.confidence > 0) & (points.confidence <= 1))


def test_the_stated_error_is_of_the_size_of_the_true_one(pinhole_points):
    error = off_plane(pinhole_points.position)
    assert 0.1 < np.median(error) / np.median(pinhole_points.error) < 3


@pytest.mark.ci
def test_fisheyes_find_the_same_plane():
    cameras = rig(fisheye(), PLACES)
    points = stereo_points(seen(cameras), cameras, options=QUICK)
    error = off_plane(points.position)
    # A pixel is 2.4 times as wide as the pinhole's.
    assert len(points.position) > 0.25 * SHARE * len(PLACES) * 48**2
    assert np.median(error) < 2.4 * DEPTH and np.quantile(error, 0.9) < 2.4 * DEPTH_MOST


def nearly_the_same(points, others):
    distance = KDTree(points).query(others)[0]
    return abs(len(points) - len(others)) < 0.01 * len(points) and np.mean(distance < SAME) > 0.98


def test_points_move_with_the_world(pinhole_points):
    cameras = rig(perspective(), PLACES)
    turn = np.asarray(rotation_matrix(turning(jnp.asarray([0.4, -0.8, 0.3]))))
    shift = np.array([1.0, -4.0, 2.0])
    path = cameras.trajectory
    poses = turn @ np.asarray(jax.vmap(rotation_matrix)(path.quat[:, 0]))
    moved = eqx.tree_at(
        lambda c: (c.trajectory.quat, c.trajectory.translation),
        cameras,
        (
            jax.vmap(quaternion)(jnp.asarray(poses))[:, None],
            path.translation @ turn.T + shift[None, None],
        ),
    )
    points = stereo_points(seen(cameras), moved, options=QUICK)
    assert nearly_the_same(pinhole_points.position @ turn.T + shift, points.position)


def test_the_order_of_the_cameras_does_not_matter(pinhole_points):
    cameras, order = rig(perspective(), PLACES), np.array([3, 0, 4, 2, 1])
    turned = jax.tree.map(lambda x: x[order], cameras)
    points = stereo_points(seen(cameras)[order], turned, options=QUICK)
    assert nearly_the_same(pinhole_points.position, points.position)


@pytest.mark.ci
def test_several_views_at_once_find_the_same(pinhole_points):
    cameras = rig(perspective(), PLACES)
    # Two views of 48 x 48 pixels with each of their neighbours; the last batch is not full.
    several = replace(QUICK, at_once=2 * 48**2 * min(QUICK.neighbours, len(PLACES) - 1))
    points = stereo_points(seen(cameras), cameras, options=several)
    assert nearly_the_same(pinhole_points.position, points.position)


@pytest.mark.ci
def test_several_levels_and_places_at_once_find_the_same(pinhole_points):
    cameras = rig(perspective(), PLACES)
    options = replace(QUICK, levels=3, places=4)
    together = stereo_points(seen(cameras), cameras, options=options)
    assert nearly_the_same(pinhole_points.position, together.position)


def test_masked_pixels_have_no_points(pinhole_points):
    cameras = rig(perspective(), PLACES)
    masks = np.ones((len(PLACES), 48, 48), bool)
    masks[:, :, :24] = False
    points = stereo_points(seen(cameras), cameras, masks, options=QUICK)
    assert 0 < len(points.position) < 0.7 * len(pinhole_points.position)


def test_about_as_many_points_are_kept_as_asked_for(pinhole_points):
    points = evenly(pinhole_points, 500)
    assert 400 < len(points.position) < 600
    assert np.median(off_plane(points.position)) < DEPTH
    assert np.median(points.scale) > 2 * np.median(pinhole_points.scale)


def test_one_view_is_refused():
    cameras = rig(perspective(), PLACES[:1])
    with pytest.raises(ValueError, match="at least 2 views"):
        stereo_points(seen(cameras), cameras, options=QUICK)


@pytest.mark.parametrize("size", [(100, 100), (270, 480), (1080, 1920)])
def test_reduced_pictures_have_about_as_many_pixels_as_allowed(size):
    h, w = (n // reduction(size, 33_000) for n in size)
    assert 4_000 < h * w < 1.2 * 33_000
