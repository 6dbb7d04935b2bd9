"""Turns at which a body looks alike: the steady spin among them is found."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaussray.reconstruct.initialize.steady_turns import (
    HIT,
    LEAP,
    NEARER,
    STEADY,
    continuous,
    expected_turns,
    steadiest,
    tumbling,
)


# Uneven, as where a frame is missing.
TIMES = np.array([0.0, 1, 2, 3, 5, 6, 7]) / 7
SPIN = np.radians([40.0, 100, -60]) * 7 / 3
# Of the way from one spin to another.
SHARES = np.linspace(0, 1, 2001)[:, None]


def quaternions(rotation):
    """Scalar first."""
    return rotation.as_quat()[..., [3, 0, 1, 2]]


def spinning(times=TIMES, spin=SPIN):
    """Turns of a body that spins evenly about an axis."""
    return Rotation.from_rotvec(np.outer(times, spin))


def alike(true, order, dice):
    """Candidates of a body that looks the same after each third of a turn about its own axis, in
    random order, and where the true ones are."""
    turns, places = [quaternions(true[:1])], [0]
    for one in true[1:]:
        all_ = [one * Rotation.from_rotvec([0, 0, 2 * np.pi * k / order]) for k in range(order)]
        shuffled = dice.permutation(order)
        turns.append(np.stack([quaternions(all_[k]) for k in shuffled]))
        places.append(int(np.flatnonzero(shuffled == 0)[0]))
    return turns, np.array(places)


@pytest.mark.parametrize("order", [2, 3, 6])
def test_a_steady_spin_is_found_among_turns_that_look_alike(order):
    dice = np.random.default_rng(order)
    turns, true = alike(spinning(), order, dice)
    # Costs differ by up to a level of an 8-bit picture, at random.
    cost = [0.004 * dice.random(len(own)) for own in turns]
    np.testing.assert_array_equal(steadiest(turns, cost, TIMES), true)
    # A capture's times are in single precision.
    np.testing.assert_array_equal(steadiest(turns, cost, TIMES.astype(np.float32)), true)


def test_a_body_that_is_hit_spins_on_otherwise():
    before = spinning(TIMES[:4])
    after = Rotation.from_rotvec(np.outer(TIMES[4:] - TIMES[3], [0, 0, 1.5])) * before[3]
    path = Rotation.concatenate([before, after])
    turns, true = alike(path, 3, np.random.default_rng(5))
    cost = [np.zeros(len(own)) for own in turns]
    np.testing.assert_array_equal(steadiest(turns, cost, TIMES), true)


def test_a_likeness_that_some_pictures_show_better_is_none():
    # A ball of which half is known looks better by far where the other half is hidden.
    times = np.linspace(0, 1, 15)
    turns, true = alike(spinning(times, 2.5 * SPIN), 2, np.random.default_rng(4))
    cost = [0.02 * (np.arange(len(own)) == k) for own, k in zip(turns, true, strict=True)]
    cost = [own if 8 <= i < 12 else 0.02 - own for i, own in enumerate(cost)]
    np.testing.assert_array_equal(steadiest(turns, cost, times), true)


def test_what_the_pictures_tell_for_certain_counts_more_than_an_even_spin():
    turns, true = alike(spinning(), 3, np.random.default_rng(1))
    cost = [np.where(np.arange(len(own)) == k, 0.1, 0) for own, k in zip(turns, true, strict=True)]
    cost[0][:] = 0
    found = steadiest(turns, cost, TIMES)
    assert (found[1:] != true[1:]).all()


@pytest.mark.parametrize("seed", range(8))
def test_the_least_sum_is_that_of_brute_force(seed):
    dice, times = np.random.default_rng(seed), np.array([0.0, 0.2, 0.3, 0.7, 1.0])
    # Turns near one another, so that changes of spin are not all beyond HIT.
    some = [dice.normal(size=(1 if i == 0 else 3, 3)) for i in range(5)]
    rotation = [Rotation.from_rotvec(0.4 * own) for own in some]
    turns = [quaternions(own) for own in rotation]
    cost = [0.03 * dice.random(len(own)) for own in turns]

    def total(chosen):
        spins = [
            (rotation[i + 1][chosen[i + 1]] * rotation[i][chosen[i]].inv()).as_rotvec()
            / (times[i + 1] - times[i])
            for i in range(4)
        ]
        value = sum(cost[i][chosen[i]] for i in range(1, 5))
        for i in range(4):
            value += NEARER * np.linalg.norm(spins[i]) * (times[i + 1] - times[i])
            # Beyond the first and the last spin, as if they were as those next to them.
            before, after = spins[max(i - 1, 0)], spins[min(i + 1, 3)]
            around = {0: (after, after), 3: (before, before)}.get(i, (before, after))
            between = (1 - SHARES) * around[0] + SHARES * around[1]
            away = np.linalg.norm(spins[i] - between, axis=1).min()
            value += LEAP * away * (times[i + 1] - times[i])
        for i in range(1, 4):
            step = min(times[i] - times[i - 1], times[i + 1] - times[i])
            value += STEADY * min(np.linalg.norm(spins[i] - spins[i - 1]) * step, HIT)
        return value

    every = itertools.product(*(range(len(own)) for own in turns))
    np.testing.assert_array_equal(steadiest(turns, cost, times), min(every, key=total))


def test_a_steady_spin_is_expected_from_either_side():
    turn = quaternions(spinning())
    wrong = turn.copy()
    wrong[3] = quaternions(Rotation.from_rotvec([0.5, 1, 0]))
    for found in expected_turns(wrong, TIMES, 3):
        assert abs(found @ turn[3]) == pytest.approx(1, abs=1e-12)
    # At the ends one side says nothing.
    np.testing.assert_array_equal(expected_turns(turn, TIMES, 1)[0], turn[1])
    np.testing.assert_array_equal(expected_turns(turn, TIMES, 6)[1], turn[6])


def test_neighbouring_quaternions_have_one_sign():
    turn = quaternions(spinning(np.linspace(0, 3, 50)))
    signs = np.where(np.random.default_rng(2).random(50) < 0.5, -1, 1)
    found = continuous(signs[:, None] * turn)
    assert (np.sum(found[1:] * found[:-1], axis=1) > 0).all()
    np.testing.assert_array_equal(np.abs(found), np.abs(turn))
    np.testing.assert_array_equal(found[0], signs[0] * turn[0])


def test_a_body_tumbles_where_its_spin_changes():
    steady = quaternions(spinning())
    odd = steady.copy()
    odd[3] = quaternions(Rotation.from_rotvec([0, 0, 1.2]) * spinning()[3])
    np.testing.assert_array_equal(tumbling(np.stack([steady, odd]), TIMES), [False, True])
    assert not tumbling(odd[None, :2], TIMES[:2]).any()
