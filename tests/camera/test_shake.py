"""The shaking hand: its law, its spectrum, and that time and seed alone decide."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gaussray.camera.shake import Shake, shake_pose, unit_shake
from gaussray.geometry import RigidTransform, rotation_matrix


# Means over 4,000 hands: 1 / sqrt(4000) = 0.016, four times that.
MEAN = 0.065
# The correlation of 64 waves against its law up to five correlation times.
WAVES = 0.007


def shake(turn=0.1, move=0.2, correlation_time=0.5, seed=3):
    return Shake(*(jnp.array(float(x)) for x in (turn, move, correlation_time, seed)))


hands = jax.jit(jax.vmap(jax.vmap(unit_shake, in_axes=(None, 0)), in_axes=(0, None)))
DELAY = jnp.array([0.0, 0.25, 0.5, 1.0, 2.0]) + 0.4


@pytest.fixture(scope="module")
def many():
    """Six processes of 4,000 hands at five times."""
    each = jax.vmap(lambda seed: Shake(*map(jnp.asarray, (0.1, 0.2, 0.5)), seed))
    return np.asarray(hands(each(jnp.arange(4000.0)), DELAY))


def test_every_process_is_normal_at_any_time(many):
    np.testing.assert_allclose(many.mean(axis=0), 0, atol=MEAN)
    np.testing.assert_allclose(many.std(axis=0), 1, atol=MEAN)
    np.testing.assert_allclose((many**4).mean(axis=0), 3, atol=0.6)


def test_correlation_falls_as_its_law_says_and_axes_are_independent(many):
    found = np.mean(many[:, :1] * many, axis=(0, 2))
    expected = np.exp(-((np.asarray(DELAY) - 0.4) ** 2) / (2 * 0.5**2))
    np.testing.assert_allclose(found, expected, atol=MEAN / np.sqrt(6) + WAVES)
    between = np.corrcoef(many[:, 2].T) - np.eye(6)
    assert np.abs(between).max() < MEAN


def test_time_and_seed_alone_decide():
    one = jax.vmap(unit_shake, in_axes=(None, 0))
    same, other = one(shake(), DELAY), one(shake(seed=4), DELAY)
    np.testing.assert_array_equal(same[::-1], one(shake(), DELAY[::-1]))
    assert np.abs(same - other).max() > 0.5
    single = jax.tree.map(lambda x: x.astype(jnp.float32), (shake(), DELAY))
    np.testing.assert_allclose(one(*single), same, atol=1e-5)


def test_a_single_precision_camera_shakes_in_single_precision():
    number = [jnp.asarray(x, jnp.float32) for x in (0.02, 0.05, 0.3, 1.0, 0.7)]
    assert unit_shake(Shake(*number[:4]), number[4]).dtype == jnp.float32


def test_the_hand_turns_and_moves_the_camera_in_its_own_axes():
    quat = jnp.array([0.5, 0.5, -0.5, 0.5])
    pose = RigidTransform(quat, jnp.array([1.0, 2.0, 3.0]))
    x = np.asarray(unit_shake(shake(), jnp.array(0.7)))
    found = shake_pose(shake(), pose, jnp.array(0.7))
    turn = rotation_matrix(quat)
    np.testing.assert_allclose(found.translation, pose.translation + turn @ (0.2 * x[3:]))
    relative = turn.T @ rotation_matrix(found.quat)
    angle = np.arccos((np.trace(relative) - 1) / 2)
    np.testing.assert_allclose(angle, 0.1 * np.linalg.norm(x[:3]), rtol=1e-9)
    still = shake_pose(shake(0, 0), pose, jnp.array(0.7))
    np.testing.assert_array_equal(still.quat, quat)
    np.testing.assert_array_equal(still.translation, pose.translation)


def test_gradients_are_right_in_amplitudes_and_times():
    pose = RigidTransform(jnp.array([1.0, 0, 0, 0]), jnp.zeros(3))

    @jax.jit
    def seen(turn, move, correlation_time, time):
        hand = Shake(*map(jnp.asarray, (turn, move, correlation_time)), jnp.array(3.0))
        return shake_pose(hand, pose, jnp.asarray(time)).apply(jnp.array([0.3, -1.0, 2.0]))

    check_grads(seen, tuple(map(jnp.array, (0.1, 0.2, 0.5, 0.7))), order=1, modes=["rev"])


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"turn": -0.1}, "trajectory.shake.turn must be at least 0"),
        ({"move": np.inf}, "trajectory.shake.move must be at least 0"),
        ({"correlation_time": 0}, "trajectory.shake.correlation_time must be above 0"),
        ({"seed": 0.5}, "trajectory.shake.seed must be a whole number in"),
        ({"seed": 2**24}, "trajectory.shake.seed must be a whole number in"),
    ],
)
def test_what_is_no_shake_is_refused_by_name(changes, message):
    with pytest.raises(ValueError, match=message):
        shake(**changes)
