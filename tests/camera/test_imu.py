"""An inertial measurement unit feels what mechanics says, on paths whose motion is known."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaussray.camera.imu import ImuOptions, imu_samples
from gaussray.camera.shake import Shake
from gaussray.camera.trajectory import Trajectory, pose_at


G = 9.81
# Sums of a few numbers of order 10 in double precision.
EXACT = 1e-9
RATE, RADIUS = 0.7, 2.5
# Radians between the poses of the circle. The velocity at a pose is that of a parabola, so the
# acceleration is off by up to the step times the jerk.
STEP = 0.01
CIRCLE = 1.01 * STEP * RATE**2 * RADIUS
NONE = ImuOptions(gravity=(0.0, 0.0, 0.0))
SHAKE = Shake(turn=0.02, move=0.03, correlation_time=0.3, seed=4.0)


def wxyz(rotations):
    return rotations.as_quat()[:, [3, 0, 1, 2]]


def circle():
    """Around the z axis (up), looking ahead along the path; y of the camera is down."""
    time = np.arange(0, 9, STEP / RATE)
    angle = RATE * time
    place = RADIUS * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    ahead = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    down = np.broadcast_to([0.0, 0.0, -1.0], ahead.shape)
    axes = np.stack([np.cross(down, ahead), down, ahead], axis=2)
    return Trajectory(time, wxyz(Rotation.from_matrix(axes)), place, "spline")


def wild(shake=None):
    """A path that turns and moves about all axes, in double precision."""
    rng = np.random.default_rng(2)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(size=(7, 3)) * 0.3, axis=0))
    return Trajectory(
        np.array([0.0, 0.4, 1.0, 1.3, 2.0, 2.6, 3.0]),
        wxyz(turns),
        rng.normal(size=(7, 3)),
        "spline",
        shake,
    )


def test_a_camera_at_rest_measures_the_opposite_of_gravity():
    turn = Rotation.from_rotvec([0.4, -1.0, 0.3])
    path = Trajectory(0.0, turn.as_quat()[[3, 0, 1, 2]].tolist(), [1.0, 2.0, 3.0])
    found = imu_samples(path, np.array([-1.0, 0.0, 2.5]), options=ImuOptions())
    np.testing.assert_allclose(found.gyroscope, 0, atol=EXACT)
    up = turn.inv().apply([0.0, 0.0, G])
    # The quaternion of the path is in single precision where plain numbers are given.
    np.testing.assert_allclose(found.accelerometer, np.tile(up, (3, 1)), atol=1e-5)
    np.testing.assert_allclose(found.velocity, 0, atol=EXACT)


def test_a_circle_is_felt_as_centripetal_force_at_a_constant_rate():
    path = circle()
    time = np.arange(100, 1700) / 200
    found = imu_samples(path, time, options=ImuOptions())
    # The path turns left about the world's up, which is -y of the camera.
    np.testing.assert_allclose(found.gyroscope, [[0, -RATE, 0]] * len(time), atol=EXACT)
    inward = RATE**2 * RADIUS
    force = np.array([-inward, -G, 0.0])
    np.testing.assert_allclose(found.accelerometer, np.tile(force, (len(time), 1)), atol=CIRCLE)
    speed = np.linalg.norm(found.velocity, axis=1)
    np.testing.assert_allclose(speed, RATE * RADIUS, rtol=STEP**2)


def test_units_of_length_and_time_are_converted():
    """2 units a metre and 4 seconds a unit of time: an even push of 3 scene units per unit squared
    is 3 / 2 / 16 m/s^2."""
    time = np.linspace(0, 3, 7)
    place = np.stack([1.5 * time**2, 0 * time, 0 * time], axis=1)
    path = Trajectory(time, np.tile([1.0, 0, 0, 0], (7, 1)), place, "spline")
    options = ImuOptions(gravity=(0.0, 0.0, 0.0), units_per_metre=2.0, seconds_per_unit=4.0)
    found = imu_samples(path, np.array([0.0, 2.0, 5.0, 8.0, 12.0]), options=options)
    push = [3 / 2 / 16, 0, 0]
    # Beside a pose by a millionth of an interval.
    np.testing.assert_allclose(found.accelerometer, np.tile(push, (5, 1)), atol=1e-7)
    np.testing.assert_allclose(found.velocity[2], [3 * 1.25 / 2 / 4, 0, 0], atol=1e-7)


@pytest.mark.parametrize("shake", [None, SHAKE], ids=["smooth", "shaken"])
def test_derivatives_are_those_of_differences(shake):
    """Between poses, and just after a pose, where the acceleration jumps."""
    path, step = wild(shake), 1e-4
    time = np.array([0.2, 0.7001, 1.0 + 2 * step, 1.777, 2.95])

    def at(times):
        poses = [pose_at(path, jnp.asarray(t)) for t in times]
        turns = Rotation.from_quat(np.stack([p.quat for p in poses])[:, [1, 2, 3, 0]])
        return np.stack([p.translation for p in poses]), turns

    found = imu_samples(path, time, options=NONE)
    (before, back), (here, turn), (after, on) = at(time - step), at(time), at(time + step)
    np.testing.assert_allclose(found.position, here, atol=EXACT)
    np.testing.assert_allclose(found.velocity, (after - before) / (2 * step), atol=1e-4)
    push = (after - 2 * here + before) / step**2
    np.testing.assert_allclose(found.accelerometer, turn.inv().apply(push), atol=1e-3)
    rate = (back.inv() * on).as_rotvec() / (2 * step)
    np.testing.assert_allclose(found.gyroscope, rate, atol=1e-4)


def test_at_a_pose_the_shake_of_the_camera_does_not_jump():
    """A pose is where two pieces meet: what is felt there is what is felt just after it."""
    # As many times as other tests ask for, with which it shares its program.
    time = 1.3 + np.array([0, 1e-5, 0.1, 0.2, 0.3])
    found = imu_samples(wild(SHAKE), time, options=NONE)
    np.testing.assert_allclose(found.accelerometer[0], found.accelerometer[1], atol=2e-2)
    np.testing.assert_allclose(found.gyroscope[0], found.gyroscope[1], atol=1e-3)


def test_what_is_felt_leads_along_the_path():
    """Integrating both sensors from the first state ends at the last one."""
    options, step = ImuOptions(rate=2000.0), 1 / 2000
    time = np.arange(0.0, 3.0, step)
    found = imu_samples(wild(), time, options=options)
    turn, place, velocity = (
        Rotation.from_quat(found.quat[0, [1, 2, 3, 0]]),
        *(x[0] for x in (found.position, found.velocity)),
    )
    for k in range(len(time) - 1):
        rate = (found.gyroscope[k] + found.gyroscope[k + 1]) / 2
        push = (found.accelerometer[k] + found.accelerometer[k + 1]) / 2
        half = turn * Rotation.from_rotvec(rate * step / 2)
        free = half.apply(push) + options.gravity
        place = place + velocity * step + free * step**2 / 2
        velocity, turn = velocity + free * step, turn * Rotation.from_rotvec(rate * step)
    # The trapezoid's error at 2 kHz: half a jump of acceleration for a step at each of five poses.
    assert np.linalg.norm(place - found.position[-1]) < 0.05
    assert np.linalg.norm(velocity - found.velocity[-1]) < 0.05
    last = Rotation.from_quat(found.quat[-1, [1, 2, 3, 0]])
    assert (turn.inv() * last).magnitude() < 1e-3


def test_noise_is_off_by_default_and_has_its_density():
    path, time = wild(), np.arange(20000) / 20000 * 3
    clean = imu_samples(path, time, options=NONE)
    assert not clean.gyroscope_bias.any() and not clean.accelerometer_bias.any()
    noisy = ImuOptions(
        gravity=NONE.gravity,
        rate=100.0,
        gyroscope_noise=1e-3,
        accelerometer_walk=2e-2,
        seed=1,
    )
    found = imu_samples(path, time, options=noisy)
    # Deviation of 60,000 numbers: within 2 %.
    assert np.std(found.gyroscope - clean.gyroscope) == pytest.approx(1e-2, rel=0.02)
    bias = found.accelerometer_bias
    np.testing.assert_allclose(found.accelerometer, clean.accelerometer + bias, atol=EXACT)
    step = np.std(np.diff(bias, axis=0))
    assert step == pytest.approx(2e-2 * (3 / 20000) ** 0.5, rel=0.02)


def test_a_path_with_corners_is_refused():
    path = wild()
    corners = Trajectory(path.time, path.quat, path.translation)
    with pytest.raises(ValueError, match=r"trajectory\.interpolation=spline"):
        imu_samples(corners, np.zeros(1), options=NONE)
    with pytest.raises(ValueError, match=r"imu\.rate must be above 0"):
        ImuOptions(rate=0.0)
    with pytest.raises(ValueError, match=r"imu\.gravity must be three numbers"):
        ImuOptions(gravity=(0.0, 9.81))
