"""The twin without effects sees the same field of view, in the middle of the frame's time."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.aperture import Aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.ideal_pinhole import ideal_pinhole_of
from gaussray.camera.lens import PROJECTIONS, Division, KannalaBrandt, RayTable, pinhole
from gaussray.camera.shutter import Shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.render.rig.lens import LensOptions, build_lens


def filmed(lens):
    """A camera that moves along x, one unit per unit of time, with every effect."""
    path = Trajectory(
        jnp.array([0.0, 10.0]),
        jnp.array([[1.0, 0, 0, 0]] * 2),
        jnp.array([[0.0, 0, 0], [10, 0, 0]]),
    )
    shutter = Shutter(jnp.array(0.5), jnp.array(0.1), jnp.array(0.3))
    aperture = Aperture(*map(jnp.array, (0.1, 2.0, 0.0, 1.0)))
    return Camera(Film(20, 11), lens, aperture, shutter, path, jnp.array(4.0))


def fisheye(focal, limit=1.5):
    return KannalaBrandt(jnp.full(2, focal), jnp.array([10.0, 5.5]), jnp.zeros(4), jnp.array(limit))


def test_a_perspective_lens_loses_its_distortion_and_the_pose_is_that_of_the_middle_row():
    lens = pinhole(jnp.array([30.0, 31.0]), jnp.array([9.0, 6.0]), jnp.full(8, 1e-3))
    twin = ideal_pinhole_of(filmed(lens))
    np.testing.assert_array_equal(twin.lens.focal, lens.focal)
    np.testing.assert_array_equal(twin.lens.center, lens.center)
    assert not np.any(twin.lens.distortion) and float(twin.aperture.radius) == 0
    # Rows 0 to 10 are read from 4.5 to 5.5.
    np.testing.assert_allclose([twin.time, twin.trajectory.translation[0, 0]], 5.0, rtol=1e-12)
    assert not any(jax.tree.leaves(twin.shutter))


def test_a_lens_with_another_model_of_distortion_is_a_perspective_one_too():
    lens = Division((30.0, 31.0), (9.0, 6.0), (-0.1,), 0.8)
    twin = ideal_pinhole_of(filmed(lens))
    np.testing.assert_array_equal(twin.lens.focal, lens.focal)
    np.testing.assert_array_equal(twin.lens.center, lens.center)


def test_pixels_keep_their_shape():
    lens = KannalaBrandt([12.5, 10.0], jnp.array([10.0, 5.5]), jnp.zeros(4), jnp.array(1.5))
    x, y = np.asarray(ideal_pinhole_of(filmed(lens)).lens.focal)
    np.testing.assert_allclose(y / x, 0.8, rtol=1e-12)


def test_a_table_of_rays_becomes_a_pinhole_of_square_pixels():
    lens, (x, y) = pinhole(jnp.array([30.0, 30.0]), jnp.array([10.0, 5.5])), np.indices((6, 6))
    spacing = np.array([4.0, 2.2])
    pixels = jnp.asarray(np.stack([y, x], axis=-1) * spacing)
    rays = jax.vmap(jax.vmap(lens.direction))(pixels)
    table = RayTable(spacing, np.zeros(2), rays)
    # Directions between those of the table are interpolated.
    np.testing.assert_allclose(ideal_pinhole_of(filmed(table)).lens.focal, 30, rtol=1e-3)


def test_a_fisheye_becomes_the_pinhole_of_the_same_angle_across():
    # r = f theta: the edges, 10 pixels away, are seen at 10 / f.
    twin = ideal_pinhole_of(filmed(fisheye(12.5)))
    edge = np.asarray(twin.lens.direction(jnp.array([20.0, 5.5])))
    np.testing.assert_allclose(np.arctan2(edge[0], edge[2]), 0.8, rtol=1e-12)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_what_a_pinhole_just_shows_is_not_refused_for_its_rounding(projection):
    lens = build_lens(Film(20, 20), LensOptions(projection, 170.0))
    camera = filmed(lens)
    twin = ideal_pinhole_of(dataclasses.replace(camera, film=Film(20, 20)))
    np.testing.assert_allclose(twin.lens.focal, 10 / np.tan(np.radians(85)), rtol=1e-3)


def test_more_than_a_pinhole_shows_is_refused():
    with pytest.raises(ValueError, match="labels: sharp needs a picture of at most 170 degrees"):
        ideal_pinhole_of(filmed(fisheye(5.0, limit=1.57)))


def test_the_twin_of_a_twin_is_the_twin():
    twin = ideal_pinhole_of(filmed(fisheye(12.5)))
    again = ideal_pinhole_of(twin)
    for a, b in zip(jax.tree.leaves(twin), jax.tree.leaves(again), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)
    assert dataclasses.replace(again, film=twin.film).film == twin.film
