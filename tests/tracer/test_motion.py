"""Arcs through the key states: their control points, shares and bounds, and what stands for a
Gaussian between them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from jax.test_util import check_grads
from scenes import gaussians, moving, resting, wandering

from gaussray.scene.gaussians import Gaussians, whitening_matrix
from gaussray.tracer.motion import (
    Motion,
    active_controls,
    arc_weights,
    control_points,
    control_weights,
    is_valid,
)
from gaussray.tracer.table import gaussian_table, state_at


EXACT = 1e-12
TIMES = np.array([-1.0, 0.0, 0.1, 0.3, 0.6, 0.7, 0.95, 1.0, 3.0])
# Key times, by their number.
KEYS = {
    1: np.zeros(1),
    2: np.array([0.0, 1.0]),
    3: np.array([0.0, 0.6, 1.0]),
    5: np.array([0.0, 0.2, 0.4, 0.75, 1.0]),
}
WINDOWS = [(-2, -1), (0, 0), (0.1, 0.2), (0.3, 0.5), (0.5, 0.7), (0.7, 9), (2, 3)]

rows_of = jax.jit(gaussian_table)
shares = jax.jit(jax.vmap(control_weights, in_axes=(None, 0)))
points = jax.jit(control_points)


def at(motion, time):
    """Mean and axes F at every time, blended from the control points as the tracer does."""
    weight = np.asarray(shares(motion.time, jnp.asarray(time)))
    return [np.tensordot(weight, np.asarray(x), 1) for x in points(motion)]


def states(matter):
    """Mean and axes F at the keys."""
    return matter.mean, reference.rotation(matter.quat) * matter.scale[..., None, :]


@pytest.mark.parametrize("keys", KEYS)
def test_shares_are_not_negative_and_sum_to_one(keys):
    found = np.asarray(shares(jnp.asarray(KEYS[keys]), jnp.asarray(TIMES)))
    assert found.shape == (len(TIMES), keys) and np.all(found >= 0)
    np.testing.assert_allclose(np.sum(found, axis=1), 1, atol=EXACT)


@pytest.mark.parametrize("keys", [2, 3, 5])
def test_three_control_points_in_a_row_hold_all_shares(keys):
    key_time, time = jnp.asarray(KEYS[keys]), jnp.asarray(TIMES)
    weight, first = jax.jit(arc_weights)(key_time, time)
    whole = np.zeros((len(TIMES), keys + 2))
    for i in range(3):
        whole[np.arange(len(TIMES)), np.asarray(first) + i] += np.asarray(weight)[:, i]
    np.testing.assert_allclose(whole[:, :keys], shares(key_time, time), atol=EXACT)
    assert not np.any(whole[:, keys:])


def test_two_keys_share_by_hat_functions():
    found = np.asarray(shares(jnp.asarray(KEYS[2]), jnp.asarray(TIMES)))
    ends = np.interp(TIMES, KEYS[2], [0, 1])
    np.testing.assert_allclose(found, np.stack([1 - ends, ends], axis=1), atol=EXACT)


def test_inner_control_point_is_twice_the_middle_less_the_mean_of_the_ends():
    _, matter = moving(5)
    motion = wandering([1.0, 2.0, 3.0], matter, np.float64)
    for found, (a, m, b) in zip(points(motion), states(matter), strict=True):
        np.testing.assert_allclose(found, np.stack([a, 2 * m - (a + b) / 2, b]), atol=EXACT)


@pytest.mark.parametrize("keys", KEYS)
def test_at_the_key_times_the_scene_is_in_the_key_states(keys):
    _, matter = moving(5, keys)
    motion = wandering(KEYS[keys], matter, np.float64)
    for found, expected in zip(at(motion, KEYS[keys]), states(matter), strict=True):
        np.testing.assert_allclose(found, expected, atol=EXACT)


@pytest.mark.parametrize("keys", KEYS)
def test_between_three_keys_and_beyond_the_last_the_scene_is_on_their_parabola(keys):
    _, matter = moving(5, keys)
    motion = wandering(KEYS[keys], matter, np.float64)
    lagrange = reference.key_shares(KEYS[keys], TIMES)
    for found, state in zip(at(motion, TIMES), states(matter), strict=True):
        np.testing.assert_allclose(found, np.tensordot(lagrange, state, 1), atol=EXACT)


@pytest.mark.parametrize("keys", [3, 5])
def test_constant_acceleration_is_exact_however_the_keys_are_spaced(keys):
    r = np.random.default_rng(0)
    start, speed, acceleration = r.normal(size=(3, 5, 3))

    def fall(time):
        t = time[:, None, None]
        return start + t * speed + t**2 / 2 * acceleration

    _, matter = moving(5, keys)
    motion = wandering(KEYS[keys], matter._replace(mean=fall(KEYS[keys])), np.float64)
    time = np.linspace(0, 1, 23)
    np.testing.assert_allclose(at(motion, time)[0], fall(time), atol=EXACT)


def test_error_is_of_third_order_in_the_spacing_of_the_keys():
    errors = []
    for keys in (9, 17):
        key_time, time = np.linspace(0, 1, keys), np.linspace(0, 1, 999)
        circle = [np.stack([np.cos(5 * t), np.sin(5 * t), t], -1) for t in (key_time, time)]
        _, matter = moving(1, keys)
        motion = wandering(key_time, matter._replace(mean=circle[0][:, None]), np.float64)
        errors.append(np.max(np.abs(at(motion, time)[0][:, 0] - circle[1])))
    assert 7 < errors[0] / errors[1] < 9


@pytest.mark.parametrize("keys", KEYS)
def test_no_time_of_a_window_leaves_the_bounds_of_its_active_control_points(keys):
    _, matter = moving(20, keys, size=(0.01, 1.0), amount=0.5)
    motion = wandering(KEYS[keys], matter, np.float64)
    center, frame = (np.asarray(x) for x in points(motion))
    normal = np.random.default_rng(1).normal(size=(30, 3))

    def support(center, frame):
        across = np.einsum("da,knab->kndb", normal, frame)
        return np.einsum("da,kna->knd", normal, center) + np.linalg.norm(across, axis=-1)

    for window in WINDOWS:
        reached = support(center, frame)[active(KEYS[keys], window)]
        bound = np.max(reached, axis=0)
        between = reference.key_shares(KEYS[keys], np.linspace(*window, 101))
        held = support(*(np.tensordot(between, state, 1) for state in states(matter)))
        assert np.all(held <= bound + EXACT)


@pytest.mark.parametrize("keys", KEYS)
@pytest.mark.parametrize("window", WINDOWS)
def test_control_points_with_a_share_in_a_window_are_active_and_no_others(keys, window):
    inside = np.asarray(shares(jnp.asarray(KEYS[keys]), jnp.linspace(*window, 101)))
    found = active(KEYS[keys], window)
    assert np.all(found[np.any(inside > 0, axis=0)])
    # Those whose share begins or ends at the very edge of the window may be active too.
    edges = jnp.array([window[0] - 0.01, window[1] + 0.01])
    wider = np.concatenate([inside, shares(jnp.asarray(KEYS[keys]), edges)])
    assert not np.any(found[np.all(wider == 0, axis=0)])


def active(key_time, window):
    return np.asarray(
        active_controls(jnp.asarray(key_time), *(jnp.array(float(t)) for t in window))
    )


def test_gradients_to_times_and_key_states_are_finite_differences():
    _, matter = moving(2, 5)
    motion = wandering(KEYS[5], matter, np.float64)

    def place(key_time, mean, quat, scale, time):
        g = motion.gaussians
        blend = control_weights(key_time, time)
        moved = Motion(key_time, Gaussians(mean, quat, scale, g.opacity, g.harmonics))
        return [jnp.tensordot(blend, x, 1) for x in control_points(moved)]

    g = motion.gaussians
    for time in (0.1, 0.45, 0.9):
        arguments = (motion.time, g.mean, g.quat, g.scale, jnp.array(time))
        check_grads(jax.jit(place), arguments, order=1, modes=["rev"])


@pytest.mark.parametrize("keys", [0, 4, 6])
def test_an_even_number_of_keys_beyond_two_is_refused(keys):
    with pytest.raises(ValueError, match=f"render.keys must be 1, 2 or odd, got {keys}"):
        wandering(np.linspace(0, 1, keys), moving(1, keys)[1])


def test_a_resting_scene_keeps_the_whitening_of_its_gaussians():
    motion = resting(gaussians(5), np.float64)
    rows = rows_of(motion)
    matrix, mean = state_at(list(rows[:5].T), jnp.ones((1, 5)))
    g = motion.gaussians
    np.testing.assert_allclose(
        np.stack(matrix, -1).reshape(5, 3, 3), whitening_matrix(g.quat, g.scale)[0], rtol=EXACT
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
    np.testing.assert_array_equal(is_valid(motion.gaussians), np.arange(7) == 6)
    rows = np.asarray(rows_of(motion))
    assert rows.shape[0] == 8 and np.all(np.isfinite(rows))
