"""Points that belong together are a body, in the smallest ball around them."""

import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.reconstruct.initialize.body_groups import ball_around, body_groups
from gaussray.scene.bodies import body_of


def test_separate_clouds_are_found_as_bodies_and_strays_are_not():
    dice = np.random.default_rng(0)
    cloud = dice.normal(size=(300, 3)) * 0.05
    points = np.concatenate([cloud, cloud + [3, 0, 0], [[1.5, 1, 0]]])
    found = body_groups(points, np.array([0.0, 1.0]))
    assert sorted(np.round(np.asarray(found.pivot)[:, 0]).tolist()) == [0, 3]
    assert body_of(found, jnp.asarray(points[-1:])).tolist() == [2]


def test_no_points_hold_no_bodies():
    none = body_groups(np.zeros((0, 3), np.float32), np.array([0.0, 1.0]))
    assert none.pivot.shape == (0, 3) and none.turn.shape == (0, 2, 4)


def test_bodies_that_are_known_stay_two_where_they_touch_and_new_ones_are_found():
    centers = np.float32([[0, 0, 0], [1.05, 0, 0], [5, 0, 0], [9, 0, 0]])
    # Fibonacci's lattice: as even as a scanned surface.
    turn, height = np.pi * (1 + 5**0.5) * np.arange(300), 1 - (2 * np.arange(300) + 1) / 300
    ring = np.sqrt(1 - height**2)
    ball = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=-1)
    balls = [(center + 0.5 * ball).astype(np.float32) for center in centers]
    cloud, times = np.concatenate(balls[:3]), np.float32([0, 1])
    assert len(body_groups(cloud, times).pivot) == 2
    # The last of the known ones is not among the points that move now.
    known = centers[[0, 1, 3]], np.float32([0.55, 0.55, 0.55])
    found = body_groups(cloud, times, known=known)
    np.testing.assert_array_equal(found.pivot[:2], centers[:2])
    assert len(found.pivot) == 3 and np.linalg.norm(found.pivot[2] - centers[2]) < 0.5
    member = np.asarray(body_of(found, jnp.asarray(cloud)))
    np.testing.assert_array_equal(member, np.repeat([0, 1, 2], 300))
    assert not np.any(found.path) and len(body_groups(cloud[:0], times, known=known).pivot) == 0


@pytest.mark.parametrize("cap", [1.0, 0.0])
def test_the_smallest_ball_around_half_a_ball_is_that_of_the_ball(cap):
    dice = np.random.default_rng(0)
    place = dice.normal(size=(20_000, 3))
    place /= np.linalg.norm(place, axis=1, keepdims=True)
    place = place[place[:, 2] > -cap]
    center, radius = ball_around(np.array([3.0, -1, 2]) + 0.5 * place, gap=0.01)
    # A hundredth of the radius; the centre of a half is told less well along its axis.
    np.testing.assert_allclose(center, [3, -1, 2], atol=0.02)
    assert radius == pytest.approx(1.05 * 0.5 + 0.01, rel=0.015)
