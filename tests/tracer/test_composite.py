"""Front to back, whatever order the hits come in."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.test_util import check_grads

from gaussray.tracer.composite import composite


EXACT = 1e-12
# Finite differences of check_grads.
GRADIENT = 1e-6

blend = jax.jit(composite)


def test_two_hits_by_hand():
    alpha, t = jnp.array([0.5, 0.25]), jnp.array([2.0, 1.0])
    total, left = blend(alpha, t, jnp.array([[10.0, 100.0]]))
    np.testing.assert_allclose(total, [0.25 * 100 + 0.75 * 0.5 * 10], atol=EXACT)
    np.testing.assert_allclose(left, 0.375, atol=EXACT)


def scene(seed=0, k=6, count=5):
    r = np.random.default_rng(seed)
    alpha, t = r.uniform(0, 0.99, (k, count)), r.uniform(1, 5, (k, count))
    return jnp.asarray(alpha), jnp.asarray(t), jnp.asarray(r.normal(size=(4, k, count)))


def test_order_of_slots_does_not_matter():
    alpha, t, payload = scene()
    order = np.random.default_rng(1).permutation(len(alpha))
    one, other = blend(alpha, t, payload), blend(alpha[order], t[order], payload[:, order])
    np.testing.assert_allclose(one[0], other[0], atol=EXACT)
    np.testing.assert_allclose(one[1], other[1], atol=EXACT)


def test_weights_and_what_is_left_sum_to_one():
    alpha, t, payload = scene()
    total, left = blend(alpha, t, jnp.ones_like(payload))
    np.testing.assert_allclose(total + left[None], np.ones((4, 5)), atol=EXACT)


def test_equal_distances_are_taken_by_slot():
    total, _ = blend(jnp.array([0.5, 0.5]), jnp.ones(2), jnp.array([[1.0, 0.0]]))
    np.testing.assert_allclose(total, 0.5, atol=EXACT)


def test_an_empty_slot_has_no_effect_wherever_it_lies():
    alpha, t, payload = scene()
    total, left = blend(alpha.at[2].set(0), t, payload)
    rest = np.array([0, 1, 3, 4, 5])
    expected, clear = blend(alpha[rest], t[rest], payload[:, rest])
    np.testing.assert_allclose(total, expected, atol=EXACT)
    np.testing.assert_allclose(left, clear, atol=EXACT)


def test_gradients_are_the_finite_differences():
    alpha, t, payload = scene(k=4, count=2)
    check_grads(
        lambda a, p: blend(jnp.asarray(a), t, jnp.asarray(p)),
        (alpha, payload),
        order=1,
        modes=["rev"],
        rtol=GRADIENT,
        atol=GRADIENT,
    )
