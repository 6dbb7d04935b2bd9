"""Cameras placed by what they look at."""

import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.placement import look_at, orbit
from gaussray.camera.trajectory import pose_at


EXACT = 1e-12
# Of a spline through 48 poses a turn: place in radii, direction in radians.
SPLINE = 3e-4


def test_the_target_is_ahead_and_up_is_up():
    pose = pose_at(look_at((1, -3, 2), (1, 1, 2)), jnp.zeros(()))
    np.testing.assert_allclose(pose.inverse_apply(jnp.array([1.0, 1, 2])), [0, 0, 4], atol=EXACT)
    np.testing.assert_allclose(pose.rotate(jnp.array([0.0, -1, 0])), [0, 0, 1], atol=EXACT)
    np.testing.assert_allclose(pose.rotate(jnp.array([1.0, 0, 0])), [1, 0, 0], atol=EXACT)


def test_an_orbit_keeps_distance_height_and_target():
    eye, target = np.array([2.0, 0, 1]), jnp.array([0.0, 0, 0.5])
    path = orbit(eye, target, times=(2.0, 4.0))
    for time in np.linspace(2, 4, 23):
        pose = pose_at(path, jnp.asarray(time))
        np.testing.assert_allclose(pose.translation[2], 1, atol=SPLINE)
        np.testing.assert_allclose(np.hypot(*pose.translation[:2]), 2, atol=2 * SPLINE)
        ahead = pose.inverse_apply(target)
        np.testing.assert_allclose(ahead, [0, 0, np.hypot(2, 0.5)], atol=3 * SPLINE)
    quarter = pose_at(path, jnp.asarray(2.5)).translation
    np.testing.assert_allclose(quarter, [0, 2, 1], atol=EXACT)  # counter-clockwise from above


def test_a_view_along_up_is_refused():
    with pytest.raises(ValueError, match=r"camera\.up must not be zero or along the view"):
        look_at((0, 0, 3))
    with pytest.raises(ValueError, match="times must increase"):
        orbit((1, 0, 0), times=(1.0, 1.0))
