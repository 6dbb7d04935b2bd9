"""Control points that begin at rest are spread over the points, and move nothing."""

import jax
import numpy as np
import pytest

from gaussray.reconstruct.initialize.resting_control import resting_control_points
from gaussray.scene.control_points import control_motion


TIMES = np.linspace(0.0, 1.0, 5)

motion = jax.jit(control_motion)


@pytest.fixture(scope="module")
def cloud():
    dice = np.random.default_rng(0)
    return dice.normal(size=(400, 3)) * np.array([3.0, 1.0, 0.2])


def test_nothing_moves_at_any_time(cloud):
    found = resting_control_points(cloud, TIMES, count=20)
    place = found.pivot[:7] + 0.1
    for time in (-1.0, 0.0, 0.3, 2.0):
        path, turn = motion(found, place, np.float32(time))
        np.testing.assert_array_equal(path, 0)
        np.testing.assert_array_equal(turn, np.tile(np.float32([1, 0, 0, 0]), (7, 1)))


def test_each_next_one_is_the_farthest_of_all(cloud):
    pivot = np.asarray(resting_control_points(cloud, TIMES, count=20).pivot, float)
    for k in range(1, 20):
        away = np.linalg.norm(cloud[:, None] - pivot[None, :k], axis=-1).min(axis=1)
        mine = np.linalg.norm(pivot[k] - pivot[:k], axis=-1).min()
        # Pivots are kept in single precision.
        assert mine == pytest.approx(away.max(), rel=1e-5)


def test_the_width_is_the_mean_distance_of_three_neighbours(cloud):
    found = resting_control_points(cloud, TIMES, count=20)
    pivot = np.asarray(found.pivot)
    away = np.sort(np.linalg.norm(pivot[:, None] - pivot[None], axis=-1), axis=1)
    np.testing.assert_allclose(found.radius, away[:, 1:4].mean(axis=1), rtol=1e-5)


@pytest.mark.parametrize("points", [1, 2, 3])
def test_few_points_are_all_control_points_with_widths_above_0(cloud, points):
    found = resting_control_points(cloud[:points], TIMES, count=20)
    assert found.pivot.shape == (points, 3) and found.path.shape == (points, 5, 3)
    assert float(found.radius.min()) > 0
