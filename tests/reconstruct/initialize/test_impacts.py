"""Rigid bodies that are hit between two pictures."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaussray.reconstruct.initialize.impacts import impacts, with_impacts
from gaussray.scene.bodies import Bodies, body_pose_at


# Uneven: the picture at 0.4 is missing.
TIMES = np.array([0.0, 0.1, 0.2, 0.3, 0.5, 0.6, 0.7, 0.8])
PULL = np.array([0.0, 0.0, -20.0])
RADIUS = 0.4


def falling(times, hit, speed=(1.0, 0.5, 1.0), kept=0.8):
    """Places of a ball that falls, and bounces at a time."""
    times, speed = np.asarray(times)[:, None], np.array(speed)
    before = speed * times + PULL * times**2 / 2
    there, at_hit = speed * hit + PULL * hit**2 / 2, speed + PULL * hit
    after = there + at_hit * (1, 1, -kept) * (times - hit) + PULL * (times - hit) ** 2 / 2
    return np.where(times < hit, before, after)


def spun(times, hit, spin=(0.0, 3.0, 1.0), after=(0.0, -1.0, 2.0)):
    """Quaternions of a ball whose spin changes at a time."""
    times = np.asarray(times)
    first = Rotation.from_rotvec(np.outer(np.minimum(times, hit), spin))
    then = Rotation.from_rotvec(np.outer(np.maximum(times - hit, 0), after))
    return (then * first).as_quat()[:, [3, 0, 1, 2]]


def bodies(*path, turn=None, times=TIMES):
    path = np.stack(path)
    still = np.tile(np.array([1.0, 0, 0, 0]), (*path.shape[:2], 1))
    count = len(path)
    return Bodies(
        jnp.zeros((count, 3)),
        jnp.full(count, RADIUS),
        jnp.asarray(times, float),
        jnp.asarray(path),
        jnp.asarray(still if turn is None else turn),
    )


@pytest.mark.parametrize("hit", [0.33, 0.4, 0.45, 0.56])
def test_a_ball_that_bounces_between_two_pictures_is_where_it_was(hit):
    known = bodies(falling(TIMES, hit), turn=spun(TIMES, hit)[None])
    (found,) = impacts(known)
    # Times are compared at forty places of an interval of 0.2.
    assert found.time == pytest.approx(hit, abs=0.005) and TIMES[found.last] < hit
    bent, between = with_impacts(known), np.linspace(0.3, 0.6, 61)
    true, turns = falling(between, hit), spun(between, hit)

    def errors(poses):
        places, found = zip(*(body_pose_at(poses, jnp.asarray(t)) for t in between), strict=True)
        place = np.linalg.norm(np.array(places)[:, 0] - true, axis=1).max()
        cosine = np.abs(np.sum(np.array(found)[:, 0] * turns, axis=1))
        return place, 2 * np.arccos(np.clip(cosine, 0, 1)).max()

    # A step of the search times the change of speed, and the bend of 0.01.
    assert errors(bent)[0] < min(0.09, 0.6 * errors(known)[0])
    assert errors(bent)[1] < 0.1
    for time, place in zip(TIMES, known.path[0], strict=True):
        np.testing.assert_allclose(body_pose_at(bent, jnp.asarray(time))[0][0], place, atol=1e-6)


def test_a_ball_that_is_hit_when_a_picture_is_taken_bends_there():
    hit = float(TIMES[2])
    known = bodies(falling(TIMES, hit))
    (found,) = impacts(known)
    assert found.time == hit and found.last == found.first == 2
    between, bent = np.linspace(0.1, 0.3, 41), with_impacts(known)
    true = falling(between, hit)

    def error(poses):
        places = np.array([body_pose_at(poses, jnp.asarray(t))[0][0] for t in between])
        return np.linalg.norm(places - true, axis=1).max()

    assert error(bent) < 0.5 * error(known)


def test_a_body_that_is_taken_for_a_likeness_looks_right_on_either_side():
    spin, like = (0.0, 3.0, 1.0), Rotation.from_rotvec([0, 0, 2 * np.pi / 3])
    true = Rotation.from_rotvec(np.outer(TIMES, spin))
    turn = np.concatenate([true[:4].as_quat(), (true[4:] * like).as_quat()])[:, [3, 0, 1, 2]]
    flies = falling(TIMES, 9.0)
    known = bodies(flies, turn=turn[None])
    assert not impacts(known)
    bent = with_impacts(known)

    def away(poses, time):
        place, found = (np.array(x)[0] for x in body_pose_at(poses, jnp.asarray(time)))
        np.testing.assert_allclose(place, falling([time], 9.0)[0], atol=1e-6)
        found = Rotation.from_quat(found[[1, 2, 3, 0]])
        there = Rotation.from_rotvec(np.multiply(spin, time))
        return min((found * one.inv()).magnitude() for one in (there, there * like))

    between = [0.32, 0.36, 0.385, 0.415, 0.44, 0.48]
    assert max(away(bent, time) for time in between) < 0.03
    assert max(away(known, time) for time in between) > 0.5


def test_what_flies_rolls_or_rests_is_not_hit():
    flies, rests = falling(TIMES, 9.0), np.zeros((len(TIMES), 3))
    rolls = np.outer(TIMES, [1.0, 2, 0])
    noise = 0.01 * RADIUS * np.random.default_rng(0).normal(size=flies.shape)
    for path in (flies, rests, rolls, flies + noise, rests + noise):
        known = bodies(path)
        assert with_impacts(known) is known
    few = bodies(flies[:3], times=TIMES[:3])
    assert with_impacts(few) is few


def test_other_bodies_move_as_before():
    flies = falling(TIMES, 9.0)
    known = bodies(falling(TIMES, 0.4), flies)
    assert [hit.body for hit in impacts(known)] == [0]
    for time in np.linspace(0.2, 0.6, 41):
        place = body_pose_at(with_impacts(known), jnp.asarray(time))[0][1]
        np.testing.assert_allclose(place, falling([time], 9.0)[0], atol=1e-3)
