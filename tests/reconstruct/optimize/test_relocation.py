"""Relocation: copies look like the original, the dead move to the living, the budget holds."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.geometry import rotation_matrix
from gaussray.reconstruct.optimize.gradient_statistic import GradientStatistic, no_gradient
from gaussray.reconstruct.optimize.relocation import (
    Population,
    Presence,
    costs,
    explore,
    relocate,
    relocation_weights,
    shared_by_copies,
)
from gaussray.reconstruct.optimize.rows import occupied, with_rows
from gaussray.scene.gaussians import unconstrain
from gaussray.scene.transient import UnconstrainedTransients


DEAD_BELOW = 0.005


def costs_of(free, extent, window=None):
    """What Gaussians of one kind alone cost."""
    return costs([Presence(free, window)], extent)


shared = jax.jit(shared_by_copies)
unconstrained, priced = map(jax.jit, (unconstrain, costs_of))
wandered = jax.jit(explore, static_argnames="steps")
slopes = jax.jit(jax.grad(lambda *seen: sum(costs_of(*seen).values())))


def crowd(opacity, scale=0.1):
    """Gaussians in a row along x, with colours that name them."""
    count = len(opacity)
    mean = np.arange(count)[:, None] * np.array([[1.0, 0, 0]])
    color = np.linspace(0.1, 0.9, count)[:, None] * np.ones(3)
    return unconstrained(toy.gaussians(mean, np.full(count, scale), color, opacity))


def relocated(free, pull=None, seed=0, limit=10**6, growth=1.05):
    (after,) = relocated_together([free], [pull], seed=seed, limit=limit, growth=growth)
    return after


def relocated_together(frees, pulls=None, seed=0, limit=10**6, growth=1.05):
    pulls = pulls or [None] * len(frees)
    populations = tuple(
        Population(free, pull or no_gradient(free.logit_opacity.shape[0]))
        for free, pull in zip(frees, pulls, strict=True)
    )
    return relocate(
        populations,
        jax.random.key(seed),
        opacity=DEAD_BELOW,
        limit=jnp.asarray(limit, jnp.int32),
        growth=growth,
    )


def opacities(free):
    return np.asarray(jax.nn.sigmoid(free.logit_opacity))


@pytest.mark.parametrize("opacity", [0.02, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("copies", [1, 2, 3, 7, 51])
def test_copies_at_one_place_composite_to_the_original(opacity, copies):
    alpha, factor = (float(x[0]) for x in shared(jnp.array([opacity]), jnp.array([copies])))
    np.testing.assert_allclose(1 - (1 - alpha) ** copies, opacity, rtol=1e-6)
    # The light of the whole footprint, by quadrature over the plane.
    r = np.linspace(0, 9, 200001)
    together = 1 - (1 - alpha * np.exp(-0.5 * (r / factor) ** 2)) ** copies
    single = opacity * np.exp(-0.5 * r**2)
    np.testing.assert_allclose(
        np.trapezoid(r * together, r), np.trapezoid(r * single, r), rtol=1e-5
    )


def test_the_factor_of_scale_equals_the_binomial_series():
    alpha, factor = shared(jnp.full(8, 0.8), jnp.arange(1, 9))
    for i, (a, f) in enumerate(zip(np.asarray(alpha), np.asarray(factor), strict=True)):
        series = sum(math.comb(i + 1, k) * (-1) ** (k + 1) * a**k / k for k in range(1, i + 2))
        np.testing.assert_allclose(f, math.sqrt(0.8 / series), rtol=1e-6)


def test_one_copy_is_the_original():
    alpha, factor = shared(jnp.array([0.1, 0.7]), jnp.array([1, 1]))
    np.testing.assert_allclose(alpha, [0.1, 0.7], rtol=1e-6)
    np.testing.assert_allclose(factor, 1, rtol=1e-6)


def test_a_dead_gaussian_becomes_a_copy_of_a_live_one_and_both_share_its_opacity():
    free = crowd([0.8, 0.001])
    after, fresh = relocated(free, growth=1.0)
    assert fresh.tolist() == [True, True]
    np.testing.assert_array_equal(after.mean[1], free.mean[0])
    np.testing.assert_array_equal(after.harmonics[1], free.harmonics[0])
    alpha, factor = shared(jnp.array([0.8]), jnp.array([2]))
    np.testing.assert_allclose(opacities(after), alpha[0], rtol=1e-5)
    np.testing.assert_allclose(np.exp(after.log_scale), 0.1 * factor[0], rtol=1e-5)


def test_without_dead_ones_and_without_room_nothing_changes():
    free = crowd([0.8, 0.3, 0.5])
    after, fresh = relocated(free, growth=1.5)
    assert not fresh.any()
    for a, b in zip(jax.tree.leaves(after), jax.tree.leaves(free), strict=True):
        np.testing.assert_array_equal(a, b)


def test_where_all_are_dead_nothing_changes():
    free = crowd([0.001, 0.002])
    after, fresh = relocated(free)
    assert not fresh.any()
    for a, b in zip(jax.tree.leaves(after), jax.tree.leaves(free), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_number_grows_by_the_factor_up_to_the_budget():
    free = with_rows(crowd(np.full(40, 0.5)), 64)
    assert occupied(relocated(free, growth=1.05)[0]).sum() == 42
    assert occupied(relocated(free, growth=1.5, limit=50)[0]).sum() == 50
    assert occupied(relocated(free, growth=1.5, limit=20)[0]).sum() == 40
    assert occupied(relocated(free, growth=9.0)[0]).sum() == 64
    # New ones are copies of some that were there.
    after, fresh = relocated(free, growth=1.5)
    assert np.isin(np.asarray(after.mean[40:60, 0]), np.arange(40)).all()
    assert fresh[40:60].all() and not fresh[60:].any()


def test_opacity_and_error_decide_in_equal_parts():
    free = crowd([0.2, 0.6, 0.2, 0.001])
    pull = GradientStatistic(toy.single([8, 0, 2, 99]), toy.single([2, 0, 2, 1]))
    live = jnp.array([True, True, True, False])
    (found,) = relocation_weights((Population(free, pull),), [live])
    np.testing.assert_allclose(found, [0.2 + 0.8, 0.6, 0.2 + 0.2, 0], atol=1e-6)


def fleeting(free):
    """The same Gaussians as transient ones."""
    count = len(free.mean)
    zero = jnp.zeros(count)
    return UnconstrainedTransients(
        mean=free.mean,
        velocity=jnp.ones((count, 3)),
        quat=free.quat,
        log_scale=free.log_scale,
        logit_opacity=free.logit_opacity,
        harmonics=free.harmonics,
        instant=jnp.arange(float(count)),
        log_lifetime=zero,
        plateau=zero,
    )


def test_the_budget_flows_to_the_kind_that_is_wanted():
    # Half of each kind is dead; the error is all with the transient ones.
    still = crowd(np.where(np.arange(400) % 2, 0.5, 0.001))
    brief = with_rows(fleeting(still), 800)
    pull = GradientStatistic(jnp.ones(800), jnp.ones(800))
    parts = relocated_together([still, brief], [no_gradient(400), pull], growth=1.0)
    (static, changed), (transient, fresh) = parts
    held = occupied(static).sum(), occupied(transient).sum()
    # Of 400 dead ones a quarter (half of the opacity, none of the error) stays static.
    assert held == (300, 500)
    assert changed[occupied(still) & ~occupied(static)].all()
    # Copies have the time and the velocity of their originals.
    copies = np.flatnonzero(np.asarray(fresh) & occupied(transient))
    assert np.isin(np.asarray(transient.instant)[copies], np.arange(1, 400, 2)).all()
    assert (np.asarray(transient.velocity)[copies] == 1).all()


def test_what_is_not_there_at_a_time_costs_nothing():
    free = fleeting(crowd([0.2, 0.6]))
    window = jnp.array([0.5, 0.0])
    found = priced(free, 2.0, window)
    np.testing.assert_allclose(found["opacity"], 0.1 / 2, rtol=1e-6)
    np.testing.assert_allclose(found["scale"], 0.1 / 2 / 2, rtol=1e-6)
    slope = slopes(free, 2.0, window)
    assert slope.logit_opacity[0] > 0 and slope.logit_opacity[1] == 0
    assert not np.asarray(slope.log_scale[1]).any()


def test_a_kind_costs_as_many_times_as_its_factor_says():
    free, extent = fleeting(crowd([0.2, 0.6])), 2.0
    kinds = [Presence(crowd([0.5])), Presence(free, jnp.ones(2), 10.0)]
    found = jax.jit(lambda: costs(kinds, extent))()
    np.testing.assert_allclose(found["opacity"], (0.5 + 10 * 0.8) / 3, rtol=1e-6)
    np.testing.assert_allclose(found["scale"], (0.1 + 10 * 0.2) / 3 / extent, rtol=1e-6)


def test_draws_follow_the_weights():
    opacity = np.concatenate([[0.9, 0.45], np.full(6000, 0.001)])
    free = crowd(opacity)
    after, _ = relocated(free, growth=1.0)
    share = (np.asarray(after.mean[2:, 0]) == 0).mean()
    # Two thirds of 6000 draws, within five standard deviations.
    assert abs(share - 2 / 3) < 5 * math.sqrt(2 / 9 / 6000)
    # Copies beyond the table of 51 still live.
    assert (opacities(after) >= 0.99 * DEAD_BELOW).all()


def test_the_same_key_moves_the_same_gaussians():
    free = crowd([0.5, 0.5, 0.5, 0.5, 0.001, 0.001, 0.001, 0.001])
    one, two = (relocated(free, seed=3)[0].mean for _ in range(2))
    np.testing.assert_array_equal(one, two)
    others = [np.asarray(relocated(free, seed=seed)[0].mean) for seed in range(4)]
    assert any((x != one).any() for x in others)


def test_only_the_faint_explore_and_by_their_covariance():
    count = 4000
    base = crowd(np.where(np.arange(count) % 2, 0.9, 1e-4))
    scale = jnp.log(jnp.broadcast_to(jnp.array([0.3, 0.1, 0.02]), base.log_scale.shape))
    quat = jnp.broadcast_to(jnp.array([0.9, 0.1, -0.3, 0.2]), base.quat.shape)
    free = eqx.tree_at(lambda f: (f.log_scale, f.quat), base, (scale, quat))
    moved = wandered(free, jax.random.key(0), size=2.0, extent=4.0).mean - free.mean
    np.testing.assert_allclose(moved[1::2], 0, atol=1e-12)
    frame = np.asarray(rotation_matrix(quat[0]))
    covariance = frame @ np.diag([0.09, 0.01, 0.0004]) @ frame.T
    faint = 1 / (1 + np.exp(-100 * (0.005 - 1e-4)))
    expected = (2.0 / 4.0 * faint) ** 2 * covariance @ covariance
    found = np.asarray(moved[::2], np.float64)
    # 2000 draws: relative errors of variances of some 3 %.
    np.testing.assert_allclose(found.T @ found / len(found), expected, atol=0.15 * expected.max())


def test_the_noise_of_many_steps_is_that_of_their_sum():
    free = crowd(np.full(4000, 1e-4))
    for size in (0.01, 80.0):  # The latter is cut at the longest axis.
        moved = [
            wandered(free, key, size=size, extent=1.0, steps=steps).mean - free.mean
            for key, steps in zip(jax.random.split(jax.random.key(1), 2), (1, 16), strict=True)
        ]
        one, many = (np.sqrt(np.mean(np.square(x, dtype=np.float64))) for x in moved)
        # 12,000 numbers: relative errors of 1 %.
        assert many == pytest.approx(4 * one, rel=0.05)


def test_no_step_of_exploration_is_longer_than_the_gaussian():
    free = eqx.tree_at(lambda f: f.log_scale, crowd(np.full(500, 1e-4)), replace_fn=lambda x: x + 5)
    moved = wandered(free, jax.random.key(0), size=80.0, extent=1.0).mean - free.mean
    length = np.linalg.norm(moved, axis=1)
    longest = np.exp(np.asarray(free.log_scale)).max(axis=1)
    assert (length <= longest * (1 + 1e-6)).all() and length.max() > 0.1 * longest.max()


def test_empty_rows_cost_nothing_and_do_not_move():
    free = with_rows(crowd([0.2, 0.6]), 5)
    found = priced(free, 2.0)
    np.testing.assert_allclose(found["opacity"], 0.4, rtol=1e-6)
    np.testing.assert_allclose(found["scale"], 0.1 / 2, rtol=1e-6)
    slope = slopes(free, 2.0)
    assert (
        not np.asarray(slope.logit_opacity[2:]).any() and not np.asarray(slope.log_scale[2:]).any()
    )
    np.testing.assert_allclose(slope.log_scale[:2], 0.1 / 2 / 6, rtol=1e-5)
    moved = wandered(free, jax.random.key(0), size=2.0, extent=1.0)
    np.testing.assert_array_equal(moved.mean[2:], free.mean[2:])


def test_no_gaussians_have_no_costs():
    none = jax.tree.map(lambda x: x[:0], crowd([0.5]))
    assert {name: float(x) for name, x in costs_of(none, 1.0).items()} == {"opacity": 0, "scale": 0}
