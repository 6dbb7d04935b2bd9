"""Cameras placed by what they look at."""

import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.placement import look_at, orbit
from gaussray.camera.trajectory import pose_at


EXACT = 1e-12
# Of a spline through 48 poses a turn: distance in radii; direction in radians.
SPLINE, DIRECTION = 1e-5, 4e-5


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
        np.testing.assert_allclose(ahead, [0, 0, np.hypot(2, 0.5)], atol=2 * DIRECTION)
    quarter = pose_at(path, jnp.asarray(2.5)).translation
    np.testing.assert_allclose(quarter, [0, 2, 1], atol=EXACT)  # counter-clockwise from above


@pytest.mark.parametrize("turns", [0.02, -0.03, 0.05, 1.3])
def test_an_arc_is_one_and_goes_on_beyond_its_times(turns):
    path = orbit((2, 0, 1), turns=turns)
    for time in (-0.01, 0.0, 0.01, 0.5, 0.99, 1.01):
        angle = 2 * np.pi * turns * time
        expected = [2 * np.cos(angle), 2 * np.sin(angle), 1]
        place = pose_at(path, jnp.asarray(time)).translation
        np.testing.assert_allclose(place, expected, atol=2 * DIRECTION)
        assert abs(np.hypot(*place[:2]) - 2) < 2 * SPLINE


def test_a_view_along_up_is_refused():
    with pytest.raises(
        ValueError, match=r"eye and camera\.target must differ, got \[0\.1, 2, 3\] f"
    ):
        look_at((0.1, 2, 3), (0.1, 2, 3))
    with pytest.raises(ValueError, match=r"along the view .* up \[0\.1, 0, 0\]\.$"):
        look_at((0, 0, 0), (1, 0, 0), (0.1, 0, 0))
    with pytest.raises(ValueError, match=r"camera\.up must not be zero or along the view"):
        look_at((0, 0, 3))
    with pytest.raises(ValueError, match="times must increase"):
        orbit((1, 0, 0), times=(1.0, 1.0))
    with pytest.raises(ValueError, match="turns must be a number, got nan"):
        orbit((1, 0, 0), turns=np.nan)
    with pytest.raises(ValueError, match="times must be the first and the last"):
        orbit((1, 0, 0), times=(0.0, 1.0, 2.0))
