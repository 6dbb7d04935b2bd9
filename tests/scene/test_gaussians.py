"""Physical and unconstrained Gaussians, and the frames that stand for their shape."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference

from gaussray.scene.gaussians import (
    Gaussians,
    Unconstrained,
    concatenate,
    constrain,
    principal_axes,
    unconstrain,
    whitening_matrix,
)


EXACT = 1e-12


def some(count, *, keys=(), degree=1, seed=0):
    r = np.random.default_rng(seed)
    values = (
        r.normal(size=(*keys, count, 3)),
        r.normal(size=(*keys, count, 4)),
        r.uniform(0.1, 2, (*keys, count, 3)),
        r.uniform(0.01, 0.99, count),
        r.normal(size=(count, (degree + 1) ** 2, 3)),
    )
    return Gaussians(*(jnp.asarray(x) for x in values))


def test_unconstrain_is_the_inverse_of_constrain():
    there = unconstrain(some(5))
    back = constrain(there)
    for a, b in zip(jax.tree.leaves(back), jax.tree.leaves(some(5)), strict=True):
        np.testing.assert_allclose(a, b, atol=EXACT)


def test_any_free_value_is_physical():
    extreme = jnp.array([-50.0, 0, 50.0])
    zeros = jnp.zeros((3, 3))
    free = Unconstrained(
        zeros, jnp.zeros((3, 4)), extreme[:, None] + zeros, extreme, zeros[:, None]
    )
    physical = constrain(free)
    assert np.all(physical.scale > 0) and np.all(np.isfinite(physical.scale))
    assert np.all((physical.opacity >= 0) & (physical.opacity <= 1))
    np.testing.assert_allclose(physical.opacity[1], 0.5, atol=EXACT)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_opacities_of_zero_and_one_stay_finite(dtype):
    whole = jax.tree.map(lambda x: x.astype(dtype), some(2))
    edge = Gaussians(whole.mean, whole.quat, whole.scale, jnp.array([0, 1], dtype), whole.harmonics)
    free = unconstrain(edge)
    assert np.all(np.isfinite(free.logit_opacity)) and free.logit_opacity.dtype == dtype
    np.testing.assert_allclose(constrain(free).opacity, [0, 1], atol=4 * np.finfo(dtype).eps)


def test_whitening_undoes_axes_and_axes_give_the_covariance():
    g = some(20)
    matrix = np.asarray(principal_axes(g.quat, g.scale))
    expected = reference.rotation(g.quat) * np.asarray(g.scale)[:, None, :]
    np.testing.assert_allclose(matrix, expected, atol=EXACT)
    unit = np.asarray(whitening_matrix(g.quat, g.scale)) @ matrix
    np.testing.assert_allclose(unit, np.tile(np.eye(3), (20, 1, 1)), atol=EXACT)


def test_concatenated_sets_keep_order_degree_and_colour():
    first, second = some(2, degree=0), some(3, degree=2, seed=1)
    both = concatenate(first, second)
    assert both.count == 5 and both.harmonics.shape == (5, 9, 3)
    np.testing.assert_array_equal(both.mean[2:], second.mean)
    np.testing.assert_array_equal(both.harmonics[:2, :1], first.harmonics)
    assert not np.any(both.harmonics[:2, 1:])


def test_a_resting_set_is_repeated_at_every_key_of_a_moving_one():
    resting, moving = some(2), some(3, keys=(4,), seed=1)
    both = concatenate(resting, moving)
    assert both.mean.shape == (4, 5, 3) and both.quat.shape == (4, 5, 4)
    for key in range(4):
        np.testing.assert_array_equal(both.scale[key, :2], resting.scale)
        np.testing.assert_array_equal(both.scale[key, 2:], moving.scale[key])


def test_a_set_of_none_changes_nothing():
    g = some(3)
    both = concatenate(g, jax.tree.map(lambda x: x[:0], g))
    for a, b in zip(jax.tree.leaves(both), jax.tree.leaves(g), strict=True):
        np.testing.assert_array_equal(a, b)
