"""The camera's pose over time."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.camera.shake import Shake, shake_pose
from gaussray.geometry import (
    RigidTransform,
    conjugate,
    inlined,
    multiply,
    normalize_quaternion,
    rotation_vector,
    slerp,
    turning,
)
from gaussray.io.plain_values import readable, rows, vector
from gaussray.io.validate import require


INTERPOLATIONS = ("linear", "spline")


class Trajectory(eqx.Module):
    """Poses world_from_camera at increasing times; a single pose is a fixed camera.

    Args:
        time: times of the poses, strictly increasing, in the capture's unit.
        quat: rotations as quaternions (w, x, y, z), not zero.
        translation: positions of the camera in scene units.
        interpolation: between poses: "linear", or "spline" (see `pose_at`).
        shake: camera shake around that path; None is none.

    Raises:
        ValueError: If a value breaks its rule.
    """

    time: Float[Array, " poses"] = eqx.field(
        default=(0.0,), converter=vector("trajectory.time", spread=True)
    )
    quat: Float[Array, "poses 4"] = eqx.field(
        default=(1.0, 0.0, 0.0, 0.0), converter=rows("trajectory.quat", 4)
    )
    translation: Float[Array, "poses 3"] = eqx.field(
        default=(0.0, 0.0, 0.0), converter=rows("trajectory.translation", 3)
    )
    interpolation: str = eqx.field(static=True, default="linear")
    shake: Shake | None = None

    def __check_init__(self):
        poses = self.time.shape[0]
        if poses < 1 or self.quat.shape[0] != poses or self.translation.shape[0] != poses:
            raise ValueError(
                "trajectory must be one quaternion and one translation for each of at least one "
                f"time, got {poses} times, {self.quat.shape[0]} quaternions and "
                f"{self.translation.shape[0]} translations."
            )
        require(
            "trajectory.time",
            self.time,
            lambda t: np.all(np.isfinite(t)) & np.all(np.diff(t) > 0),
            "finite and strictly increasing",
            "Sort the poses by time and keep one per time.",
        )
        require("trajectory.translation", self.translation, np.isfinite, "finite")
        require(
            "trajectory.quat",
            self.quat,
            lambda q: np.all(np.isfinite(q)) & np.all(np.any(q != 0, axis=-1)),
            "finite and not zero",
        )
        if self.interpolation not in INTERPOLATIONS:
            raise ValueError(
                f"trajectory.interpolation must be one of {INTERPOLATIONS}, got "
                f"{self.interpolation!r}."
            )

    def __repr__(self) -> str:
        return readable(self)


def static_trajectory(pose: RigidTransform) -> Trajectory:
    """The trajectory of a camera that does not move."""
    time = jnp.zeros(1, pose.translation.dtype)
    return Trajectory(time, pose.quat[None], pose.translation[None])


@inlined
def pose_at(trajectory: Trajectory, time: Float[Array, ""]) -> RigidTransform:
    """world_from_camera at a time.

    "linear" is straight and at constant turn rate between neighbouring poses. "spline" moves
    position and rotation each on a cubic through the poses, velocity and turn rate continuous (see
    `_velocity` and `_rotation_at`). Before the first and after the last pose the camera stands
    still. A `shake` is composed on top of either, at any time.

    Args:
        trajectory: the trajectory.
        time: in the capture's unit.
    """
    pose = _on_path(trajectory, time)
    return pose if trajectory.shake is None else shake_pose(trajectory.shake, pose, time)


def _on_path(trajectory: Trajectory, time: Float[Array, ""]) -> RigidTransform:
    knots = trajectory.time
    if knots.shape[0] == 1:
        return RigidTransform(trajectory.quat[0], trajectory.translation[0])
    before = jnp.clip(jnp.searchsorted(knots, time, side="right") - 1, 0, knots.shape[0] - 2)
    after = before + 1
    fraction = jnp.clip((time - knots[before]) / (knots[after] - knots[before]), 0, 1)
    start, end = trajectory.translation[before], trajectory.translation[after]
    if trajectory.interpolation == "linear":
        return RigidTransform(
            slerp(trajectory.quat[before], trajectory.quat[after], fraction),
            start + fraction * (end - start),
        )
    steps = knots[1:] - knots[:-1]
    quat = normalize_quaternion(trajectory.quat)
    turns = jax.vmap(rotation_vector)(multiply(conjugate(quat[:-1]), quat[1:])) / steps[:, None]
    moves = (trajectory.translation[1:] - trajectory.translation[:-1]) / steps[:, None]
    step = steps[before]
    spin, spin_end = (step * _velocity(turns, steps, k) for k in (before, after))
    speed, speed_end = (step * _velocity(moves, steps, k) for k in (before, after))
    x = fraction
    position = start + x * x * (3 - 2 * x) * (end - start)
    position = position + x * (1 - x) * ((1 - x) * speed - x * speed_end)
    return RigidTransform(_rotation_at(quat[before], quat[after], spin, spin_end, x), position)


def _velocity(
    slope: Float[Array, "intervals 3"], step: Float[Array, " intervals"], knot: Int[Array, ""]
) -> Float[Array, "3"]:
    """Velocity at a knot: that of the parabola through it and its two neighbours, or through the
    three poses at an end. Uneven times are right, and motion at even acceleration is exact.
    """
    last = slope.shape[0] - 1
    if last == 0:
        return slope[0]
    left = jnp.clip(knot - 1, 0, last - 1)
    a, b = step[left], step[left + 1]
    # The parabola's velocity is linear in time, and the slopes are those in the intervals' middles.
    middle = jnp.where(knot == 0, -a / 2, jnp.where(knot == last + 1, a / 2 + b, a / 2))
    return slope[left] + middle / ((a + b) / 2) * (slope[left + 1] - slope[left])


def _rotation_at(
    start: Float[Array, "4"],
    end: Float[Array, "4"],
    spin_start: Float[Array, "3"],
    spin_end: Float[Array, "3"],
    x: Float[Array, ""],
) -> Float[Array, "4"]:
    """Rotation on the cubic from `start` to `end` with these turns per interval at its ends, in the
    camera's axes: start exp(b1 w1) exp(b2 w2) exp(b3 w3) with the cumulative Bernstein polynomials
    b of degree 3 (Kim, Kim and Shin 1995), w1 and w3 a third of the turns, and w2 what is left.
    """
    first, third = spin_start / 3, spin_end / 3
    rest = multiply(turning(-first), multiply(conjugate(start), end))
    second = rotation_vector(multiply(rest, turning(-third)))
    b = 1 - (1 - x) ** 3, x * x * (3 - 2 * x), x**3
    turn = multiply(turning(b[1] * second), turning(b[2] * third))
    return multiply(start, multiply(turning(b[0] * first), turn))
