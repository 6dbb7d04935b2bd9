"""The free space around cameras: how far it reaches, and what is removed from it."""

import jax
import numpy as np
import pytest
import toy

from gaussray.reconstruct.optimize.free_space import (
    FreeBalls,
    free_balls,
    in_free_space,
    without_near_gaussians,
)
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.rows import occupied
from gaussray.reconstruct.optimize.state import begin_state
from gaussray.scene.gaussians import unconstrain


# Rounding of distances to single precision.
ROUNDING = 1e-6


def ball_of_points(count=5000, radius=1.0, seed=0):
    """Points on a sphere about the origin."""
    place = np.random.default_rng(seed).normal(size=(count, 3))
    return radius * place / np.linalg.norm(place, axis=1, keepdims=True)


def test_a_camera_amid_a_sphere_has_half_of_it():
    space = free_balls(np.zeros((1, 3)), ball_of_points(radius=3.0), 0.5)
    np.testing.assert_array_equal(space.center, np.zeros((1, 3)))
    np.testing.assert_allclose(space.radius, [1.5], rtol=ROUNDING)


def test_space_is_free_midway_between_neighbours_too():
    eye = np.array([[0, 0, 0], [2.0, 0, 0], [2.0, 0, 0]])
    wall = np.stack(
        [*np.meshgrid(np.linspace(-4, 4, 81), np.linspace(-4, 4, 81)), np.ones((81, 81))]
    )
    points = wall.reshape(3, -1).T * [1, 1, 4]
    space = free_balls(eye, points, 0.25)
    assert sorted(map(tuple, space.center.tolist())) == [(0, 0, 0), (1, 0, 0), (1, 0, 0), (2, 0, 0)]
    # The twentieth nearest point of a wall 4 away with 100 points in a unit square.
    farther = np.hypot(4, np.sqrt(20 / (100 * np.pi)))
    np.testing.assert_allclose(space.radius, 0.25 * farther, rtol=2e-3)


def test_a_few_wrong_points_before_a_camera_change_little():
    points = ball_of_points()
    wrong = 0.1 * ball_of_points(15, seed=1)
    both = points, np.concatenate([points, wrong])
    known, misled = (free_balls(np.zeros((1, 3)), x, 0.5) for x in both)
    np.testing.assert_allclose(misled.radius, known.radius, rtol=ROUNDING)
    # Of few points each counts.
    few = free_balls(np.zeros((1, 3)), np.concatenate([points[:40], wrong[:1]]), 0.5)
    np.testing.assert_allclose(few.radius, [0.05], rtol=ROUNDING)


@pytest.mark.parametrize(("count", "share"), [(100, 0.0), (0, 0.5)])
def test_without_points_or_share_none_is_free(count, share):
    assert free_balls(np.zeros((2, 3)), ball_of_points(count), share) is None


def test_many_cameras_are_thinned():
    eye = np.random.default_rng(2).uniform(-0.2, 0.2, (1000, 3))
    space = free_balls(eye, ball_of_points(), 0.5)
    assert len(space.center) == 256 * 5
    assert np.all(space.radius > 0.3) and np.all(space.radius < 0.6)


@pytest.mark.parametrize("balls", [1, 7, 30])
def test_who_is_inside_agrees_with_brute_force(balls):
    dice = np.random.default_rng(balls)
    space = FreeBalls(
        dice.normal(size=(balls, 3)).astype(np.float32),
        dice.uniform(0.2, 1, balls).astype(np.float32),
    )
    mean = dice.normal(size=(2000, 3)).astype(np.float32)
    away = np.linalg.norm(mean[:, None].astype(np.float64) - space.center[None], axis=-1)
    expected = np.any(away < space.radius, axis=1)
    # No place is so near to a boundary that rounding decides.
    assert np.min(np.abs(away - space.radius)) > ROUNDING
    np.testing.assert_array_equal(in_free_space(space, mean), expected)
    assert expected.any() and not expected.all()


def test_only_static_gaussians_are_removed_and_the_rest_stays_as_it_is():
    mean = [[0.0, 0, 0], [0.3, 0, 0], [0.9, 0, 0]]
    free = unconstrain(toy.gaussians(mean, [0.1] * 3, [[0.5] * 3]))
    before = begin_state(Parameters(free, free, None))
    space = FreeBalls(np.zeros((1, 3), np.float32), np.float32([0.5]))
    after = without_near_gaussians(before, space)
    assert occupied(after.parameters.static).tolist() == [False, False, True]
    kept = after.parameters.static.logit_opacity[2]
    assert kept == before.parameters.static.logit_opacity[2]
    parts = lambda state: (state.parameters.moving, state.parameters.static.mean, state.adam)  # noqa: E731
    for a, b in zip(*(jax.tree.leaves(parts(state)) for state in (before, after)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_state_without_static_gaussians_stays_as_it_is():
    free = unconstrain(toy.gaussians([[0.0, 0, 0]], 0.1, [[0.5] * 3]))
    state = begin_state(Parameters(jax.tree.map(lambda x: x[:0], free), free, None))
    space = FreeBalls(np.zeros((1, 3), np.float32), np.float32([0.5]))
    assert without_near_gaussians(state, space) is state
