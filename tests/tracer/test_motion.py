"""Key states, their shares, and what stands for a Gaussian between them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from scenes import gaussians, moving, resting, wandering

from gaussray.scene.gaussians import whitening
from gaussray.tracer.motion import active_keys, key_weights, state_at, table, usable


EXACT = 1e-12
TIMES = np.array([-1.0, 0.0, 0.1, 0.6, 0.7, 1.0, 3.0])
KEYS = np.array([0.0, 0.6, 1.0])

rows_of = jax.jit(table)
shares = jax.jit(jax.vmap(key_weights, in_axes=(None, 0)))


def test_shares_are_hat_functions_that_sum_to_one():
    found = np.asarray(shares(jnp.asarray(KEYS), jnp.asarray(TIMES)))
    np.testing.assert_allclose(found, reference.key_shares(KEYS, TIMES), atol=EXACT)
    np.testing.assert_allclose(np.sum(found, axis=1), 1, atol=EXACT)


def test_at_a_key_time_that_key_has_all():
    found = shares(jnp.asarray(KEYS), jnp.asarray(KEYS))
    np.testing.assert_array_equal(found, np.eye(3))


def test_a_single_key_has_all_at_every_time():
    found = shares(jnp.zeros(1), jnp.asarray(TIMES))
    np.testing.assert_array_equal(found, np.ones((7, 1)))


def test_slope_of_the_shares_is_one_over_the_spacing():
    slope = jax.jacobian(key_weights, argnums=1)(jnp.asarray(KEYS), jnp.array(0.7))
    np.testing.assert_allclose(slope, [0, -2.5, 2.5], atol=EXACT)


@pytest.mark.parametrize("window", [(-2, -1), (0, 0), (0.1, 0.2), (0.5, 0.7), (0.7, 9), (2, 3)])
def test_keys_with_a_share_in_a_window_are_active(window):
    found = np.asarray(active_keys(jnp.asarray(KEYS), *(jnp.array(float(t)) for t in window)))
    inside = reference.key_shares(KEYS, np.linspace(*window, 101))
    assert np.all(found[np.any(inside > 0, axis=0)])
    if window == (0.1, 0.2):
        np.testing.assert_array_equal(found, [True, True, False])


def test_a_resting_scene_keeps_the_whitening_of_its_gaussians():
    motion = resting(gaussians(5), np.float64)
    rows = rows_of(motion)
    matrix, mean = state_at(list(rows[:5].T), jnp.ones((1, 5)))
    g = motion.gaussians
    np.testing.assert_allclose(
        np.stack(matrix, -1).reshape(5, 3, 3), whitening(g.quat, g.scale)[0], rtol=EXACT
    )
    np.testing.assert_allclose(np.stack(mean, -1), g.mean[0], atol=EXACT)


# Inverse by cofactors, for axes a thousand times as long as others.
INVERSE = 1e-9


def test_between_keys_the_axes_are_interpolated_and_inverted():
    time, matter = moving(5, size=(1e-3, 1.0))
    motion = wandering(time, matter, np.float64)
    ray_time = np.array([0.0, 0.3, 0.6, 0.9, 1.0])
    weight = shares(motion.time, jnp.asarray(ray_time)).T
    matrix, mean = state_at(list(rows_of(motion)[:5].T), weight)
    frame, center = reference.frames(motion, ray_time)
    own = np.arange(5)
    matrix = np.stack(matrix, -1).reshape(5, 3, 3)
    error = np.abs(matrix - frame[own, own]) / np.max(
        np.abs(frame[own, own]), axis=2, keepdims=True
    )
    assert np.max(error) < INVERSE
    np.testing.assert_allclose(np.stack(mean, -1), center[own, own], atol=EXACT)


def test_what_is_not_finite_or_has_no_extent_is_not_usable():
    matter = gaussians(7)
    matter.mean[0, 1] = np.inf
    matter.quat[1, 0] = np.nan
    matter.scale[2, 2] = 0
    matter.scale[3, 0] = -1
    matter.opacity[4] = np.nan
    matter.harmonics[5, 3, 1] = np.inf
    motion = resting(matter)
    np.testing.assert_array_equal(usable(motion.gaussians), np.arange(7) == 6)
    rows = np.asarray(rows_of(motion))
    assert rows.shape[0] == 8 and np.all(np.isfinite(rows))
