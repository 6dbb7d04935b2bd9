"""Roots on a line and in the plane: closed forms, and first derivatives of what they depend on."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.test_util import check_grads

from gaussray.camera.roots import increasing_root, plane_root


def square(x, scale):
    return scale * x * x


def twist(x, strength):
    """A quarter of whose turn at radius 1, and a stretch: far from any straight line."""
    turn = strength * jnp.sum(x * x)
    c, s = jnp.cos(turn), jnp.sin(turn)
    return jnp.stack([c * x[0] - s * x[1], s * x[0] + c * x[1]]) * (1 + 0.1 * jnp.sum(x * x))


def fold(x, strength):
    return jnp.stack([x[0] - strength * x[0] ** 3, x[1]])


@jax.jit
def root_of(value, scale):
    return increasing_root(square, value, scale, jnp.array(9.0))


@jax.jit
def plain(value, strength):
    return plane_root(twist, value, strength, value, steps=12, residual=1e-9)


def test_a_root_on_a_line_and_its_slopes():
    value, scale = jnp.array(2.0), jnp.array(0.5)
    np.testing.assert_allclose(root_of(value, scale), 2, rtol=1e-14)
    np.testing.assert_array_equal(root_of(jnp.array(0.0), scale) < 1e-4, True)
    check_grads(root_of, (value, scale), order=1, rtol=1e-6)


def test_a_root_in_the_plane_and_its_slopes():
    x, strength = jnp.array([0.6, -0.5]), jnp.array(0.7)
    value = twist(x, strength)
    found, good = plain(value, strength)
    assert good
    np.testing.assert_allclose(found, x, atol=1e-14)
    check_grads(lambda v, s: plain(v, s)[0], (value, strength), order=1, rtol=1e-6)


def test_beyond_a_fold_nothing_is_found_and_gradients_stay_finite():
    def run(value):
        return plane_root(fold, value, jnp.array(1.0), value, steps=6, residual=1e-6)

    # x - x^3 turns back at 1/sqrt(3), where it is 0.385.
    for first, there in ((0.3, True), (0.5, False)):
        value = jnp.array([first, 0.1])
        found, good = jax.jit(run)(value)
        assert bool(good) == there
        slope = jax.jit(jax.jacrev(lambda v: run(v)[0]))(value)
        assert np.isfinite(found).all() and np.isfinite(slope).all()


def test_a_root_has_the_precision_of_what_it_depends_on():
    x, strength = jnp.array([0.6, -0.5]), jnp.full((), 0.7, float)
    single = twist(x, strength).astype(jnp.float32)
    found, good = plane_root(twist, single, strength, single, steps=12, residual=1e-6)
    assert good and found.dtype == x.dtype
    np.testing.assert_allclose(found, x, atol=1e-6)
