"""Density control by hand: who is cloned, split, pruned, and what becomes of moments."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.reconstruct.optimize.density import (
    DensityOptions,
    clone_split_prune,
    clone_split_prune_rows,
    relocate_dead,
)
from gaussray.reconstruct.optimize.gradient_statistic import (
    GradientStatistic,
    accumulate,
    no_gradient,
)
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.rows import EMPTY, occupied, with_rows
from gaussray.reconstruct.optimize.state import begin_state, renewed_moment
from gaussray.scene.gaussians import unconstrain


OPTIONS = DensityOptions(threshold=1.0, small=0.1, shrink=2.0, opacity=0.1)
EXTENT = 1.0


def crowd(opacity=(0.9, 0.9, 0.9, 0.05), scale=(0.05, 0.2, 0.05, 0.05)):
    """Four Gaussians: small, large, small, and one too faint to stay."""
    mean = np.arange(12).reshape(4, 3) / 10
    return unconstrain(toy.gaussians(mean, scale, [[0.5, 0.5, 0.5]], opacity))


def statistic(*strength):
    """Each was seen twice."""
    return GradientStatistic(2 * toy.single(strength), jnp.full(len(strength), 2.0, jnp.float32))


def refined(free, statistics, limit=100, seed=0):
    return clone_split_prune_rows(
        free, statistics, options=OPTIONS, extent=EXTENT, limit=limit, seed=seed
    )


def test_a_small_one_is_cloned_into_a_free_row():
    free = crowd()
    after, fresh = refined(free, statistic(5, 0, 0, 0))
    # The faint one is pruned, and its row taken.
    assert fresh.tolist() == [False, False, False, True]
    assert occupied(after).all()
    for name in ("mean", "quat", "log_scale", "logit_opacity", "harmonics"):
        value = getattr(after, name)
        np.testing.assert_array_equal(value[3], getattr(free, name)[0])
        np.testing.assert_array_equal(value[:3], getattr(free, name)[:3])


def test_a_large_one_is_split_into_two_smaller_ones():
    free = crowd()
    after, fresh = refined(free, statistic(0, 5, 0, 0))
    assert fresh.tolist() == [False, True, False, True]
    for row in (1, 3):
        np.testing.assert_allclose(np.exp(after.log_scale[row]), 0.1, rtol=1e-5)
        assert 0 < np.linalg.norm(after.mean[row] - free.mean[1]) < 6 * 0.2
        np.testing.assert_array_equal(after.harmonics[row], free.harmonics[1])
    assert (after.mean[1] != after.mean[3]).any()


def test_a_faint_one_is_pruned_however_large_its_gradient():
    after, fresh = refined(crowd(), statistic(0, 0, 0, 99))
    assert occupied(after).tolist() == [True, True, True, False]
    assert after.logit_opacity[3] == EMPTY
    assert not fresh.any()


def test_the_statistic_is_the_mean_over_the_steps_in_which_it_was_seen():
    # Total 3 in 4 steps is below the threshold of 1, total 3 in 2 steps is not.
    statistics = GradientStatistic(toy.single([3, 0, 3, 0]), toy.single([4, 0, 2, 0]))
    after, fresh = refined(crowd(), statistics)
    assert fresh.tolist() == [False, False, False, True]
    np.testing.assert_array_equal(after.mean[3], after.mean[2])


def test_rows_double_when_they_are_full():
    free = crowd(opacity=0.9)
    after, fresh = refined(free, statistic(5, 0, 5, 0))
    assert len(fresh) == 8
    assert occupied(after).tolist() == [True] * 6 + [False] * 2
    assert fresh.tolist() == [False] * 4 + [True] * 2 + [False] * 2


def test_the_limit_holds_and_the_strongest_go_first():
    free = crowd(opacity=0.9)
    after, fresh = refined(free, statistic(5, 0, 9, 0), limit=5)
    assert occupied(after).sum() == 5
    np.testing.assert_array_equal(after.mean[np.flatnonzero(fresh)[0]], free.mean[2])
    after, fresh = refined(free, statistic(5, 5, 5, 5), limit=4)
    assert occupied(after).sum() == 4 and not fresh.any()
    after, _ = refined(
        free, statistic(5, 5, 5, 5), limit=2
    )  # more than the limit already: none is added
    assert occupied(after).sum() == 4


def test_the_same_seed_gives_the_same_split():
    one, two, other = (refined(crowd(), statistic(0, 5, 0, 0), seed=s)[0] for s in (1, 1, 2))
    np.testing.assert_array_equal(one.mean, two.mean)
    assert (one.mean != other.mean).any()


def test_nothing_happens_to_no_gaussians():
    none = jax.tree.map(lambda x: x[:0], crowd())
    after, fresh = refined(none, no_gradient(0), limit=0)
    assert len(fresh) == 0 and after.mean.shape == (0, 3)


def test_new_rows_are_empty():
    grown = with_rows(crowd(), 7)
    assert occupied(grown).tolist() == [True] * 4 + [False] * 3
    np.testing.assert_array_equal(jnp.linalg.norm(grown.quat[4:], axis=1), 1)


def test_moments_of_new_rows_are_zero_and_of_old_rows_kept():
    moment = jnp.arange(1.0, 9.0).reshape(4, 2)
    fresh = np.array([False, True, False, False, True, False])
    expected = np.array([[1, 2], [0, 0], [5, 6], [7, 8], [0, 0], [0, 0]])
    np.testing.assert_array_equal(renewed_moment(moment, fresh), expected)


def test_a_states_moments_follow_their_rows():
    free = crowd()
    state = begin_state(Parameters(free, crowd(opacity=0.9), None))
    ones = jax.tree.map(jnp.ones_like, state.adam)
    state = eqx.tree_at(
        lambda s: (s.adam, s.static_statistic, s.moving_statistic, s.step),
        state,
        (ones, statistic(5, 0, 0, 0), statistic(5, 0, 0, 0), jnp.asarray(7, jnp.int32)),
    )
    after = clone_split_prune(state, options=OPTIONS, extent=EXTENT, limit=(10, 10), seed=0)
    for moment in (after.adam.mu, after.adam.nu):
        np.testing.assert_array_equal(moment.static.mean[:, 0], [1, 1, 1, 0])
        np.testing.assert_array_equal(moment.moving.mean[:, 0], [1, 1, 1, 1, 0, 0, 0, 0])
    assert int(after.step) == 7 and int(after.adam.count) == 1
    assert not after.static_statistic.total.any() and after.moving_statistic.seen.shape == (8,)


def test_relocation_keeps_the_rows_and_starts_moments_of_changed_ones_again():
    still = jax.tree.map(lambda x: x[:0], crowd())
    state = begin_state(Parameters(still, with_rows(crowd(), 8), None))
    ones = jax.tree.map(jnp.ones_like, state.adam)
    state = eqx.tree_at(lambda s: (s.adam, s.step), state, (ones, jnp.asarray(7, jnp.int32)))
    options = DensityOptions(kind="relocate", interval=100, opacity=0.1, gaussians=6)
    assert (options.room(4), options.room(9)) == (6, 9)
    grown = DensityOptions(growth=8.0, gaussians=20)
    assert [grown.room(n) for n in (2, 4, 30)] == [16, 20, 30]
    after = relocate_dead(state, options=options, limit=6, most={}, seed=0)
    moving = after.parameters.moving
    # The faint one became a copy; five percent of four are none.
    assert occupied(moving).tolist() == [True] * 4 + [False] * 4
    place = np.asarray(moving.mean)
    copied = (place[:3] == place[3]).all(axis=1)
    changed = np.asarray(after.adam.mu.moving.mean == 0).all(axis=1)
    assert copied.sum() == 1 and changed[:4].tolist() == [*copied, True]
    assert int(after.step) == 7 and after.parameters.static.mean.shape == (0, 3)


def test_rows_that_are_nearly_full_are_doubled_while_there_is_budget_left(monkeypatch):
    full, roomy = crowd(), with_rows(crowd(), 8)
    state = begin_state(Parameters(full, roomy, None))
    state = eqx.tree_at(lambda s: s.adam, state, jax.tree.map(jnp.ones_like, state.adam))
    options = DensityOptions(kind="relocate", interval=100, opacity=0.01)
    spent = relocate_dead(state, options=options, limit=8, most={}, seed=0)
    assert len(spent.parameters.static.mean) == 4
    after = relocate_dead(state, options=options, limit=12, most={}, seed=0)
    static, moving = after.parameters.static, after.parameters.moving
    assert occupied(static).tolist() == [True] * 4 + [False] * 4 and len(moving.mean) == 8
    np.testing.assert_array_equal(static.mean[:4], full.mean)
    np.testing.assert_array_equal(after.adam.mu.static.mean[:, 0], [1] * 4 + [0] * 4)
    assert after.static_statistic.total.shape == (8,)
    # As far as there may be so many of the kind.
    for most, rows in ((3, 4), (5, 5), (6, 6), (90, 8)):
        few = {"static": most}
        held = relocate_dead(state, options=options, limit=12, seed=0, most=few)
        assert len(held.parameters.static.mean) == rows
    # Nearly full, but with a row for all that the budget has: nothing to double.
    many = jax.tree.map(lambda x: jnp.concatenate([x] * 5), full)
    state = begin_state(Parameters(with_rows(many, 21), jax.tree.map(lambda x: x[:0], full), None))
    kept = relocate_dead(state, options=options, limit=21, most={}, seed=0)
    assert len(kept.parameters.static.mean) == 21


def test_the_statistic_is_half_the_gradient_times_the_distance():
    after = accumulate(no_gradient(2), jnp.array([[3.0, 0, 4], [0, 0, 0]]), jnp.array([2.0, 7.0]))
    np.testing.assert_allclose(after.total, [5, 0])
    np.testing.assert_array_equal(after.seen, [1, 0])


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("interval", -1), ("start", 0.9), ("growth", 0.5), ("shrink", 1.0), ("kind", "clone")),
        *(("gaussians", 0), ("noise", -1.0), ("opacity_cost", -1.0), ("scale_cost", -1.0)),
        *(("transient_cost", -1.0), ("free_space", 1.0), ("free_space", -0.1)),
    ],
)
def test_an_option_that_cannot_be_is_named(key, value):
    with pytest.raises(ValueError, match=f"density.{key}"):
        DensityOptions(**{key: value})
