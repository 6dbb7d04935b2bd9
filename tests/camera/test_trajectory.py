"""Trajectories: through their poses, straight and evenly between them, standing still outside."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gaussray.camera.shake import Shake, shake_pose
from gaussray.camera.trajectory import Trajectory, pose_at, static_trajectory
from gaussray.geometry import RigidTransform, multiply, normalize_quaternion, rotation_matrix


# Coordinates of order 10 in double precision.
EXACT = 1e-12
GRADIENT = 1e-5


pose_of = jax.jit(pose_at)
matrix_of = jax.jit(rotation_matrix)


@jax.jit
def seen(trajectory, time):
    trajectory, time = jax.tree.map(jnp.asarray, (trajectory, time))
    return pose_at(trajectory, time).apply(jnp.array([0.3, -1.0, 2.0]))


def turn(axis, angle):
    axis = np.asarray(axis) / np.linalg.norm(axis)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])


TIMES = jnp.array([0.0, 1.0, 3.0])
TRAJECTORY = Trajectory(
    TIMES,
    jnp.array([turn((0, 0, 1), 0.2), turn((0, 0, 1), 1.0), -3 * turn((1, 2, 0), 0.7)]),
    jnp.array([(0.0, 0.0, 0.0), (2.0, 0.0, 1.0), (2.0, 4.0, -1.0)]),
)


def test_poses_are_met_at_their_times():
    for time, quat, translation in zip(TIMES, TRAJECTORY.quat, TRAJECTORY.translation, strict=True):
        pose = pose_of(TRAJECTORY, time)
        np.testing.assert_allclose(pose.translation, translation, atol=EXACT)
        ours, given = matrix_of(pose.quat), matrix_of(quat)
        np.testing.assert_allclose(ours, given, atol=EXACT)


def test_halfway_is_half_the_way_and_half_the_turn():
    pose = pose_of(TRAJECTORY, jnp.array(0.5))
    np.testing.assert_allclose(pose.translation, [1, 0, 0.5], atol=EXACT)
    np.testing.assert_allclose(pose.quat, turn((0, 0, 1), 0.6), atol=EXACT)


def test_between_two_poses_speed_and_turn_rate_are_constant():
    """Equal times give equal motions: pose(t)^-1 pose(t + h) is the same for all t."""
    times = jnp.linspace(1.0, 3.0, 9)
    poses = jax.jit(jax.vmap(pose_at, in_axes=(None, 0)))(TRAJECTORY, times)
    matrix = np.array(matrix_of(poses.quat))
    steps = np.einsum("nji,njk->nik", matrix[:-1], matrix[1:])
    np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=EXACT)
    way = np.diff(poses.translation, axis=0)
    np.testing.assert_allclose(way, np.broadcast_to(way[0], way.shape), atol=EXACT)


def test_outside_its_times_the_camera_stands_still():
    for time, index in ((-5.0, 0), (9.0, 2)):
        pose = pose_of(TRAJECTORY, jnp.array(time))
        np.testing.assert_allclose(pose.translation, TRAJECTORY.translation[index], atol=EXACT)
        expected = matrix_of(TRAJECTORY.quat[index])
        np.testing.assert_allclose(matrix_of(pose.quat), expected, atol=EXACT)


def test_one_pose_is_a_fixed_camera():
    pose = RigidTransform(jnp.array(turn((1, 0, 0), 0.3)), jnp.array([1.0, 2.0, 3.0]))
    for time in (-1.0, 0.0, 7.0):
        still = pose_of(static_trajectory(pose), jnp.array(time))
        np.testing.assert_array_equal(still.translation, pose.translation)
        np.testing.assert_array_equal(still.quat, pose.quat)


@pytest.mark.parametrize("time", [0.3, 2.2])
def test_gradients_are_right_in_every_pose_and_in_time(time):
    args = (TRAJECTORY, jnp.array(time))
    check_grads(seen, args, order=1, modes=["rev"], rtol=GRADIENT)


def test_gradients_between_equal_and_opposite_orientations_are_those_by_hand():
    """Standing still, and from the third pose to the last one half a turn about x."""
    quat = jnp.array([(1.0, 0, 0, 0), (1.0, 0, 0, 0), (-1.0, 0, 0, 0), (0.0, 1.0, 0, 0)])
    still = Trajectory(jnp.arange(4.0), quat, jnp.zeros((4, 3)))

    def total(trajectory, time):
        return jnp.sum(seen(trajectory, time))

    # Not at the knots, where it turns at two rates.
    times = np.linspace(-1, 4, 21)[[*range(12), *range(13, 16), *range(17, 21)]]
    gradient = jax.jit(jax.vmap(jax.grad(total, argnums=(0, 1)), in_axes=(None, 0)))
    slope, rate = gradient(still, jnp.array(times))
    # (0, -1, 2) is at sqrt(5) (cos, sin) of an angle; from -1 to i it falls by pi a unit of time.
    angle, turning = np.arctan2(2, -1) - np.pi * (times - 2), (times > 2) & (times < 3)
    expected = -np.sqrt(5) * np.pi * (np.cos(angle) - np.sin(angle)) * turning
    np.testing.assert_allclose(rate, expected, atol=1e-9)
    share = np.clip(1 - np.abs(np.clip(times, 0, 3)[:, None] - np.arange(4)), 0, 1)
    np.testing.assert_allclose(slope.translation, np.repeat(share[..., None], 3, -1), atol=EXACT)
    # The length of a quaternion is none of the pose.
    np.testing.assert_allclose(np.sum(slope.quat * quat[None], axis=-1), 0, atol=1e-9)


def test_single_precision_stays_single():
    single = jax.tree.map(lambda x: x.astype(jnp.float32), TRAJECTORY)
    pose = pose_of(single, jnp.float32(0.4))
    assert pose.quat.dtype == pose.translation.dtype == jnp.float32
    double = normalize_quaternion(pose_of(TRAJECTORY, jnp.array(0.4)).quat)
    np.testing.assert_allclose(pose.quat, double, atol=1e-6)


@pytest.mark.parametrize(
    "time, quat, message",
    [
        ((0.0, 2.0, 1.0), TRAJECTORY.quat, "trajectory.time must be finite and strictly incr"),
        ((0.0, 1.0, 1.0), TRAJECTORY.quat, "trajectory.time must be finite and strictly incr"),
        ((0.0, 1.0, np.nan), TRAJECTORY.quat, "trajectory.time must be finite and strictly incr"),
        ((0.0, 1.0, 2.0), jnp.zeros((3, 4)), "trajectory.quat must be finite and not zero"),
    ],
)
def test_what_is_no_trajectory_is_refused_by_name(time, quat, message):
    with pytest.raises(ValueError, match=message):
        Trajectory(jnp.array(time), quat, TRAJECTORY.translation)


def test_an_empty_trajectory_is_refused():
    with pytest.raises(ValueError, match="trajectory must be one quaternion"):
        Trajectory(jnp.zeros(0), jnp.zeros((0, 4)), jnp.zeros((0, 3)))


def splined(time, quat, translation):
    parts = (jnp.asarray(x, float) for x in (time, quat, translation))
    return Trajectory(*parts, interpolation="spline")


UNEVEN = np.array([-1.0, 0.0, 0.7, 2.0, 2.5])


def wandering(seed=0):
    rng = np.random.default_rng(seed)
    return splined(UNEVEN, rng.normal(size=(5, 4)), rng.normal(size=(5, 3)))


def test_a_spline_meets_its_poses_and_stands_still_outside():
    path = wandering()
    for time, quat, translation in zip(UNEVEN, path.quat, path.translation, strict=True):
        pose = pose_of(path, jnp.array(time))
        np.testing.assert_allclose(pose.translation, translation, atol=EXACT)
        np.testing.assert_allclose(matrix_of(pose.quat), matrix_of(quat), atol=EXACT)
    for inside, outside in ((-1.0, -5.0), (2.5, 9.0)):
        a, b = (pose_of(path, jnp.array(t)) for t in (inside, outside))
        np.testing.assert_allclose(a.translation, b.translation, atol=EXACT)


def test_velocity_and_turn_rate_of_a_spline_are_continuous_where_lines_have_corners():
    path, h = wandering(), 1e-6
    lines = Trajectory(path.time, path.quat, path.translation)
    for knot in UNEVEN[1:-1]:
        jumps = []
        for way in (path, lines):
            before, at, after = (np.asarray(seen(way, knot + x)) for x in (-h, 0.0, h))
            jumps.append(np.abs((after - at) - (at - before)).max() / h)
        assert jumps[0] < 1e-3 < jumps[1]


@pytest.mark.parametrize("poses", [2, 3, 5])
def test_even_acceleration_about_one_axis_is_exact_on_a_spline(poses):
    """Places quadratic in time, and turns about one axis whose angle is quadratic."""
    power = min(poses - 1, 2)
    time = UNEVEN[:poses]
    way, bend = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.1, -0.7]) * (power == 2)

    def place(t):
        return np.asarray(t)[..., None] * way + np.asarray(t)[..., None] ** 2 * bend

    def angle(t):
        return 0.4 * t + 0.2 * t * t * (power == 2)

    axis = (1.0, 2.0, -1.0)
    path = splined(time, [turn(axis, angle(t)) for t in time], place(time))
    for t in np.linspace(time[0], time[-1], 11):
        pose = pose_of(path, jnp.array(t))
        np.testing.assert_allclose(pose.translation, place(t), atol=EXACT)
        expected = matrix_of(jnp.asarray(turn(axis, angle(t))))
        np.testing.assert_allclose(matrix_of(pose.quat), expected, atol=EXACT)


def test_a_spline_moves_with_the_world():
    """Turned and moved poses give the turned and moved path."""
    path, move = wandering(), jnp.array([3.0, -1.0, 2.0])
    spin = jnp.asarray(turn((1, 1, 0), 0.9))
    matrix = matrix_of(spin)
    quat = jax.vmap(multiply, in_axes=(None, 0))(spin, path.quat)
    moved = splined(UNEVEN, quat, path.translation @ matrix.T + move[None])
    for t in (-0.4, 0.3, 1.5, 2.4):
        np.testing.assert_allclose(seen(moved, t), matrix @ seen(path, t) + move, atol=EXACT)


def test_gradients_of_a_spline_are_right_in_poses_and_time():
    path = wandering(1)
    check_grads(seen, (path, jnp.array(0.4)), order=1, modes=["rev"], rtol=GRADIENT)
    rest = splined(UNEVEN, np.tile([1.0, 0, 0, 0], (5, 1)), np.zeros((5, 3)))
    slope = jax.grad(lambda p: jnp.sum(seen(p, 0.4)))(rest)
    # At rest as well: poses that move together take along what they see.
    np.testing.assert_allclose(np.sum(slope.translation, axis=0), 1, atol=EXACT)
    np.testing.assert_allclose(slope.quat[:, 0], 0, atol=EXACT)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(slope))


def test_a_shake_is_composed_on_any_path():
    hand = Shake(*(jnp.array(x) for x in (0.02, 0.1, 0.3, 7.0)))
    for path in (TRAJECTORY, wandering(), static_trajectory(pose_of(TRAJECTORY, jnp.array(0.4)))):
        held = dataclasses.replace(path, shake=hand)
        for t in (-2.0, 0.4, 1.1):
            expected = shake_pose(hand, pose_of(path, jnp.array(t)), jnp.array(t))
            np.testing.assert_allclose(pose_of(held, jnp.array(t)).quat, expected.quat, atol=EXACT)
            found = pose_of(held, jnp.array(t)).translation
            np.testing.assert_allclose(found, expected.translation, atol=EXACT)


def test_no_other_interpolation_is_known():
    parts = TRAJECTORY.time, TRAJECTORY.quat, TRAJECTORY.translation
    with pytest.raises(ValueError, match="trajectory.interpolation must be one of"):
        Trajectory(*parts, interpolation="bumpy")
