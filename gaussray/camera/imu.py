"""Measurements of an inertial measurement unit (IMU) on a moving camera."""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.trajectory import Trajectory, pose_at
from gaussray.geometry import conjugate, multiply, normalize_quaternion


# Derivatives are taken this far (of the time between two poses) from a pose, where acceleration
# jumps; noise of the second derivative there is 1e-10 of itself.
_KNOT_OFFSET = 1e-6
_TEXT = (
    "Render with trajectory.interpolation=spline, along which velocity and turn rate are continuous"
)


class ImuOptions(eqx.Module):
    """An inertial measurement unit whose axes are the camera's (right, down, forward).

    Args:
        rate: samples per second.
        gravity: acceleration of free fall along the world's axes, in m/s^2.
        units_per_metre: scene units per metre.
        seconds_per_unit: seconds per unit of the capture's time.
        gyroscope_noise: density of white noise, rad/s per square root of Hz; 0 is none.
        accelerometer_noise: density of white noise, m/s^2 per square root of Hz.
        gyroscope_walk: density of the white noise whose integral is the bias, rad/s^2 per square
            root of Hz.
        accelerometer_walk: the same of the accelerometer, m/s^3 per square root of Hz.
        seed: random seed of noise and bias.
    """

    rate: float = eqx.field(static=True, default=200.0)
    gravity: tuple[float, ...] = eqx.field(static=True, default=(0.0, 0.0, -9.81))
    units_per_metre: float = eqx.field(static=True, default=1.0)
    seconds_per_unit: float = eqx.field(static=True, default=1.0)
    gyroscope_noise: float = eqx.field(static=True, default=0.0)
    accelerometer_noise: float = eqx.field(static=True, default=0.0)
    gyroscope_walk: float = eqx.field(static=True, default=0.0)
    accelerometer_walk: float = eqx.field(static=True, default=0.0)
    seed: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        for key in ("rate", "units_per_metre", "seconds_per_unit"):
            value = getattr(self, key)
            if not 0 < value < math.inf:
                raise ValueError(f"imu.{key} must be above 0, got {value}.")
        for key in ("gyroscope_noise", "accelerometer_noise", "gyroscope_walk",
                    "accelerometer_walk", "seed"):  # fmt: skip
            value = getattr(self, key)
            if not 0 <= value < math.inf:
                raise ValueError(f"imu.{key} must be at least 0, got {value}.")
        if len(self.gravity) != 3 or not np.isfinite(self.gravity).all():
            raise ValueError(
                f"imu.gravity must be three numbers in m/s^2 along the world's axes, got "
                f"{list(self.gravity)}."
            )


class ImuSamples(NamedTuple):
    """Samples of an IMU and the truth about them, in metres and seconds.

    Args:
        gyroscope: turn rate about the camera's axes, rad/s, with bias and noise.
        accelerometer: specific force along the camera's axes, m/s^2, with bias and noise.
        position: of the camera in the world, m.
        quat: world_from_camera (w, x, y, z), of unit length.
        velocity: of the camera in the world, m/s.
        gyroscope_bias: rad/s.
        accelerometer_bias: m/s^2.
    """

    gyroscope: Float[np.ndarray, "samples 3"]
    accelerometer: Float[np.ndarray, "samples 3"]
    position: Float[np.ndarray, "samples 3"]
    quat: Float[np.ndarray, "samples 4"]
    velocity: Float[np.ndarray, "samples 3"]
    gyroscope_bias: Float[np.ndarray, "samples 3"]
    accelerometer_bias: Float[np.ndarray, "samples 3"]


def imu_samples(
    trajectory: Trajectory, time: Float[np.ndarray, " samples"], *, options: ImuOptions
) -> ImuSamples:
    """Sample an IMU along a camera's path, from the path's own derivatives.

    With the position p and the rotation R (world_from_camera), the accelerometer is
    R^T (p'' - gravity): a camera at rest measures the opposite of gravity. The gyroscope is the
    vector w of R^T R' = [w]x. Bias is a random walk, noise is white (Furgale et al. 2013); both
    start from `options.seed`. All is computed in double precision.

    Args:
        trajectory: the camera's path, in scene units and the capture's unit of time.
        time: times of the samples, in seconds, increasing.
        options: the IMU.

    Returns:
        The measurements, and the true pose, velocity and biases.

    Raises:
        ValueError: The path has corners: three poses or more with linear interpolation.
    """
    if trajectory.interpolation == "linear" and trajectory.time.shape[0] > 2:
        raise ValueError(
            "an IMU needs trajectory.interpolation=spline, got linear between "
            f"{trajectory.time.shape[0]} poses, whose corners have no acceleration. {_TEXT}."
        )
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), trajectory)
        seconds = options.seconds_per_unit
        parts = _motion(exact, np.asarray(time, np.float64) / seconds)
        position, quat, velocity, turn_rate, acceleration = (np.asarray(x) for x in parts)
    metres = 1 / options.units_per_metre
    specific_force = acceleration * metres / seconds**2 - np.array(options.gravity)
    bias, noise = _errors(np.asarray(time), options)
    return ImuSamples(
        gyroscope=turn_rate / seconds + bias[0] + noise[0],
        accelerometer=_in_camera(quat, specific_force) + bias[1] + noise[1],
        position=position * metres,
        quat=quat,
        velocity=velocity * metres / seconds,
        gyroscope_bias=bias[0],
        accelerometer_bias=bias[1],
    )


def camera_velocity(
    trajectory: Trajectory, time: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Turn rate and velocity of a camera along its own axes (right, down, forward).

    Both are the path's own derivatives, in double precision. At a pose where a linear path has a
    corner they are those after it.

    Args:
        trajectory: the camera's path.
        time: in the capture's unit.

    Returns:
        Radians and scene units per unit of the capture's time.
    """
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), trajectory)
        parts = _motion(exact, np.array([time], np.float64))
        _, quat, velocity, turn_rate, _ = (np.asarray(x) for x in parts)
    return turn_rate[0], _in_camera(quat, velocity)[0]


@jax.jit
def _motion(trajectory: Trajectory, time: Float[Array, " samples"]) -> tuple[Array, ...]:
    """Position, rotation, velocity, turn rate in the camera's axes, and acceleration, in scene
    units and units of time."""

    def pose(t: Array) -> tuple[Array, Array]:
        at = pose_at(trajectory, t)
        return at.translation, normalize_quaternion(at.quat)

    def velocities(t: Array) -> tuple[Array, Array]:
        (_, quat), (velocity, change) = jax.jvp(pose, (t,), (jnp.ones_like(t),))
        return velocity, 2 * multiply(conjugate(quat), change)[1:]

    def one(t: Array) -> tuple[Array, ...]:
        position, quat = pose(t)
        (velocity, turn_rate), (acceleration, _) = jax.jvp(
            velocities, (off_knot(t),), (jnp.ones_like(t),)
        )
        return position, quat, velocity, turn_rate, acceleration

    def off_knot(t: Array) -> Array:
        """The time, moved away from a pose: after it, or before the last."""
        knots = trajectory.time
        if knots.shape[0] == 1:
            return t
        offset = _KNOT_OFFSET * jnp.min(jnp.diff(knots))
        nearest = knots[jnp.argmin(jnp.abs(knots - t))]
        moved = jnp.where(nearest == knots[-1], nearest - offset, nearest + offset)
        return jnp.where(jnp.abs(t - nearest) < offset, moved, t)

    return jax.vmap(one)(time)


def _in_camera(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """World vectors along the camera's axes: R^T v."""
    w, axis = quat[:, :1], -quat[:, 1:]
    across = 2 * np.cross(axis, vector)
    return vector + w * across + np.cross(axis, across)


def _errors(time: np.ndarray, options: ImuOptions) -> tuple[np.ndarray, np.ndarray]:
    """Bias and noise [sensor, samples, 3] of gyroscope and accelerometer."""
    normal = np.random.default_rng(options.seed).normal(size=(2, 2, len(time), 3))
    walk = np.array([options.gyroscope_walk, options.accelerometer_walk])[:, None, None]
    white = np.array([options.gyroscope_noise, options.accelerometer_noise])[:, None, None]
    steps = np.sqrt(np.diff(time, prepend=time[:1]))[None, :, None]
    return np.cumsum(walk * steps * normal[0], axis=1), white * options.rate**0.5 * normal[1]
