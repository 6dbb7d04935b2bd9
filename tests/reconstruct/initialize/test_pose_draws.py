"""Draws of poses by their distributions, and the choice among poses by hand."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.reconstruct.initialize.pose_cost import Pose
from gaussray.reconstruct.initialize.pose_draws import (
    DIFFERENT,
    LOST,
    SPUN,
    change_from,
    distinct_poses,
    far_places,
    far_turns,
    least_costly,
    step_from,
)


COUNT, REACH = 20_000, 3.0
# Four standard deviations of a share of so many numbers.
SHARE = 4 * 0.5 / np.sqrt(3 * COUNT)
SIZE = jnp.array(2.0)


def poses(paths, angles):
    """Poses at places along x, turned about z."""
    half = np.array(angles) / 2
    turns = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    return Pose(jnp.array([[x, 0.0, 0.0] for x in paths]), jnp.array(turns))


def share_below(values, bounds):
    return [np.mean(np.abs(values) < bound) for bound in bounds]


@pytest.mark.parametrize(
    ("draw", "long", "width", "short", "deviation"),
    [
        (far_places, slice(3, 6), REACH, slice(0, 3), LOST),
        (far_turns, slice(0, 3), SPUN, slice(3, 6), REACH),
    ],
)
def test_far_changes_are_cauchy_distributed_and_near_ones_normally(
    draw, long, width, short, deviation
):
    change = np.asarray(draw(jax.random.key(0), COUNT, jnp.array(REACH), jnp.float64))
    assert change.shape == (COUNT, 6) and not change[0].any()
    # Quartiles of |x| of a Cauchy distribution, and one, two and three standard deviations.
    quartiles = width * np.tan(np.pi * np.array([1, 2, 3]) / 8)
    assert share_below(change[:, long], quartiles) == pytest.approx([0.25, 0.5, 0.75], abs=SHARE)
    normal = share_below(change[:, short], deviation * np.array([1, 2, 3]))
    assert normal == pytest.approx([0.6827, 0.9545, 0.9973], abs=SHARE)


def test_least_costly_poses_come_in_the_order_of_their_costs():
    rng = np.random.default_rng(0)
    cost = rng.permutation(np.arange(50.0))
    found = least_costly(poses(np.arange(50.0), np.zeros(50)), jnp.array(cost), 7)
    np.testing.assert_array_equal(found.path[:, 0], np.argsort(cost)[:7])


def test_distinct_poses_are_those_of_a_greedy_search():
    rng = np.random.default_rng(1)
    place, cost = rng.uniform(0, 20, 60), rng.permutation(np.arange(60.0))
    left, expected = list(np.argsort(cost)), []
    for _ in range(6):
        expected.append(left[0])
        left = [k for k in left if abs(place[k] - place[left[0]]) / 2 >= DIFFERENT]
    found = distinct_poses(
        poses(place, np.zeros(60)), jnp.array(cost), 6, partial(step_from, size=SIZE)
    )
    np.testing.assert_allclose(found.path[:, 0], place[expected])


def test_changes_count_radians_and_body_sizes_whatever_the_sign_of_a_quaternion():
    first, other = (jax.tree.map(lambda x: x[0], poses([x], [a])) for x, a in ((1, 0.3), (4, 1.0)))
    assert float(step_from(first, other, SIZE)) == pytest.approx(1.5)
    for factor in (1.0, -1.0, 3.0):
        scaled = other._replace(turn=factor * other.turn)
        assert float(change_from(first, scaled, SIZE)) == pytest.approx(1.5 + 0.7)
        assert float(change_from(scaled, first, SIZE)) == pytest.approx(1.5 + 0.7)
    assert float(change_from(first, first, SIZE)) == pytest.approx(0, abs=1e-7)
