"""Points that rest are told from the body that moves, and pieces of one body belong together."""

import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.reconstruct.initialize.pose_cost import Known, Mismatch
from gaussray.reconstruct.initialize.regrouping import (
    MovingGaussians,
    move,
    moving_alike,
    regrouped,
    resting_points,
)
from gaussray.scene.bodies import bodies_at_rest


POINTS = 200


def judged(difference, weight):
    """What tracking tells of points, of bodies of which none moves as another one."""
    moved, rests = difference.sum(axis=-1) / np.maximum(weight.sum(axis=-1), 1e-9)
    others = np.tile(rests, (len(rests), 1))
    return Mismatch(moved, rests, others, difference, weight)


def group(resting=0.4, *, moved=0.05, still=0.15, lost=0.15, floor=0.03, seed=0):
    """A ball above a floor, of whose points a share rests: places, differences moved and at rest,
    and weights of one view and one time."""
    dice = np.random.default_rng(seed)
    rests = np.arange(POINTS) < resting * POINTS
    place = dice.normal(size=(POINTS, 3)) / 4
    place[rests] *= 1, 1, 0.01
    place[~rests, 2] += 2
    difference = np.where(rests, [[lost], [floor]], [[moved], [still]])
    weight = dice.uniform(0.5, 3, size=(2, POINTS))
    return place[None], (difference * weight)[:, None], weight[:, None], rests


@pytest.mark.parametrize("share", [0.2, 0.45])
def test_a_floor_below_a_ball_rests(share):
    place, difference, weight, rests = group(share)
    found = resting_points(place, judged(difference, weight))
    np.testing.assert_array_equal(found[0], rests)


def test_noise_of_single_points_says_nothing():
    place, difference, weight, rests = group(0.3)
    noise = np.random.default_rng(1).uniform(0, 2, size=difference.shape)
    found = resting_points(place, judged(difference * noise, weight))
    # Means of eight such values differ by a fifth of what they are.
    assert np.mean(found[0] == rests) > 0.97


def test_a_few_points_of_one_colour_stay():
    place, difference, weight, _ = group(0.05)
    assert not resting_points(place, judged(difference, weight)).any()


def test_of_a_body_that_was_lost_nothing_rests():
    # Its points differ wherever they are looked for.
    place, difference, weight, _ = group(0.3, lost=0.17, floor=0.16, moved=0.12)
    assert not resting_points(place, judged(difference, weight)).any()


def test_a_floor_with_nothing_on_it_is_not_cut():
    place, difference, weight, _ = group(0.5, moved=0.05, still=0.055)
    assert not resting_points(place, judged(difference, weight)).any()


def test_what_no_view_sees_is_kept():
    place, difference, weight, _ = group(0.3)
    assert not resting_points(place, judged(0 * difference, 0 * weight)).any()


def test_bodies_are_judged_one_by_one():
    parts = group(0.3), group(0.0)
    place, difference, weight = (
        np.concatenate([part[i] for part in parts], axis=int(i > 0)) for i in range(3)
    )
    found = resting_points(place, judged(difference, weight))
    np.testing.assert_array_equal(found, np.stack([parts[0][3], parts[1][3]]))


# Two pieces of one ball that touch, another ball beside them, and a patch of wall far away.
PIVOT = np.array([[0, 0, 0], [0.4, 0, 0], [0, 0.9, 0], [5, 0, 0]], np.float32)
RADIUS = np.array([0.4, 0.2, 0.5, 0.3], np.float32)


def moving(others=(), moved=(0.05, 0.06, 0.05, 0.14)):
    """What tracking tells of these, with pairs of which one explains the other."""
    rests = np.full(4, 0.15)
    table = np.tile(rests, (4, 1))
    for of, body, value in others:
        table[of, body] = value
    nothing = np.zeros((2, 4, POINTS))
    return Mismatch(np.array(moved), rests, table, nothing, nothing)


def test_pieces_that_one_motion_explains_are_one_body():
    found = moving_alike(PIVOT, RADIUS, moving([(0, 1, 0.08)]))
    np.testing.assert_array_equal(found, [0, 0, 2, 3])


def test_a_piece_joins_by_the_motion_of_the_smaller_one_too():
    found = moving_alike(PIVOT, RADIUS, moving([(1, 0, 0.08)]))
    np.testing.assert_array_equal(found, [0, 0, 2, 3])


def test_bodies_that_are_apart_or_move_otherwise_stay_apart():
    found = moving_alike(PIVOT, RADIUS, moving([(0, 3, 0.05), (0, 2, 0.13)]))
    np.testing.assert_array_equal(found, [0, 1, 2, 3])


def test_what_does_not_move_itself_joins_nothing():
    found = moving_alike(PIVOT, RADIUS, moving([(1, 0, 0.08)], moved=(0.05, 0.14, 0.05, 0.14)))
    np.testing.assert_array_equal(found, [0, 1, 2, 3])
    np.testing.assert_array_equal(move(moving()), [True, True, True, False])


def test_groups_are_cut_joined_and_left_out():
    dice = np.random.default_rng(7)
    # A ball in two pieces, of which one has the floor below it; and a piece of wall, first of all.
    ball = dice.normal(size=(400, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    floor = np.concatenate([dice.uniform(-1.5, 1.5, (200, 2)), np.full((200, 1), -1.4)], axis=1)
    wall = 5 + dice.uniform(-0.5, 0.5, (100, 3))
    position = np.concatenate([wall, ball, floor]).astype(np.float32)
    piece = np.where(ball[:, 0] < 0.5, 1, 2)
    body = np.concatenate([np.zeros(100, int), piece, np.ones(200, int)])
    gaussians = MovingGaussians(body, position, position, position)
    place = np.stack([dice.choice(position[body == k], 100) for k in range(3)])
    known = Known(place, place, np.zeros((3, 100, 5), np.float32), place.mean(axis=1), np.ones(3))
    rests = place[..., 2] < -1.1
    rests[0] = True
    difference = np.stack([np.where(rests, 0.15, 0.05), np.where(rests, 0.03, 0.15)])
    difference[:, 0] = 0.1
    mismatch = judged(difference, np.ones_like(difference))
    mismatch.others[1, 2] = 0.06
    start = bodies_at_rest(jnp.asarray(place.mean(axis=1)), jnp.full(3, 2.0), jnp.arange(2.0))
    found, cut = regrouped(start, gaussians, known, mismatch)
    assert found.pivot.shape == (1, 3)
    assert (cut.body[:100] == 1).all()
    # Where both are close, 0.4 apart, points may be taken for those of the other: half of that
    # moves the middle, and widens the ball.
    assert np.mean(cut.body[100:500] == 0) > 0.9
    assert np.mean(cut.body[500:] == 1) > 0.9
    assert np.abs(found.pivot).max() < 0.25
    assert 1 < found.radius[0] < 1.45
    even = np.broadcast_to(np.array([0.05, 0.15])[:, None, None], difference.shape)
    assert regrouped(start, gaussians, known, judged(even, np.ones_like(even))) is None
