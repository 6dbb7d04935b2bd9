"""Where the camera is at every moment."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.checks import require
from gaussray.geometry import RigidTransform, slerp


class Trajectory(eqx.Module):
    """Poses (world_from_camera) at increasing times; a single pose is a fixed camera."""

    time: Float[Array, " poses"]
    quat: Float[Array, "poses 4"]
    translation: Float[Array, "poses 3"]

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


def fixed(pose: RigidTransform) -> Trajectory:
    """A camera that stays where it is."""
    time = jnp.zeros(1, pose.translation.dtype)
    return Trajectory(time, pose.quat[None], pose.translation[None])


def pose_at(trajectory: Trajectory, time: Float[Array, ""]) -> RigidTransform:
    """world_from_camera at a time: straight and at constant turn rate between neighbouring poses.

    Before the first and after the last pose the camera stands still.
    """
    knots = trajectory.time
    if knots.shape[0] == 1:
        return RigidTransform(trajectory.quat[0], trajectory.translation[0])
    before = jnp.clip(jnp.searchsorted(knots, time, side="right") - 1, 0, knots.shape[0] - 2)
    after = before + 1
    fraction = jnp.clip((time - knots[before]) / (knots[after] - knots[before]), 0, 1)
    start, end = trajectory.translation[before], trajectory.translation[after]
    return RigidTransform(
        slerp(trajectory.quat[before], trajectory.quat[after], fraction),
        start + fraction * (end - start),
    )
