"""Places a camera by what it looks at: a fixed pose, or an orbit around a point."""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.trajectory import Trajectory
from gaussray.geometry import multiply, normalize, product, quaternion, rotation_matrix, turning
from gaussray.io.plain_values import vector
from gaussray.io.validate import known, require


# What the functions of this module accept as a point or a direction.
Point = Sequence[Any] | Array | np.ndarray
# Poses of an orbit for each full turn: the spline through them deviates from the circle by less
# than 1e-5 of its radius.
POSES_PER_TURN = 48
# Poses before the first time of an orbit and after the last: at an end, a spline is less precise.
_BEYOND = 2
_Z_UP = (0.0, 0.0, 1.0)


def look_at(eye: Point, target: Point = (0.0, 0.0, 0.0), up: Point = _Z_UP) -> Trajectory:
    """The trajectory of a camera that stays at `eye` and looks at `target`.

    Args:
        eye: position of the camera in scene units.
        target: the point in the middle of the picture, elsewhere than `eye`.
        up: direction in the world that points up in the picture, not along the view. The default is
            +z, as in Blender; scenes from COLMAP often have (0, -1, 0) up.

    Returns:
        A trajectory of one pose. It is differentiable in all three.

    Raises:
        ValueError: The direction of view is zero or along `up`.
    """
    eye, turn = _pose(*_points(eye, target, up))
    time = jnp.zeros(1, eye.dtype)
    return Trajectory(time, turn[None], eye[None])


def orbit(
    eye: Point,
    target: Point = (0.0, 0.0, 0.0),
    up: Point = _Z_UP,
    *,
    turns: float | int = 1.0,
    times: Sequence[float | int] = (0.0, 1.0),
) -> Trajectory:
    """The trajectory of a camera that starts at `eye` and circles around an axis through `target`.

    The camera looks at `target` all the time and turns at constant speed, counter-clockwise as seen
    from where `up` points to.

    Args:
        eye: first position of the camera in scene units.
        target: the point in the middle of the picture, on the axis.
        up: direction of the axis, up in the picture; see `look_at`.
        turns: number of full turns; negative is clockwise.
        times: times of the first and the last pose, in the scene's unit.

    Returns:
        A trajectory of `POSES_PER_TURN` poses a turn with a spline between them, which goes on
            for two poses before the first time and after the last, for exposures that reach there.

    Raises:
        ValueError: The direction of view is zero or along `up`, the times are not two that
            increase, or `turns` is no number.
    """
    if not math.isfinite(turns):
        raise ValueError(f"orbit: turns must be a number, got {turns}.")
    if len(times) != 2:
        raise ValueError(f"orbit: times must be the first and the last, got {tuple(times)}.")
    if not times[0] < times[1]:
        raise ValueError(f"orbit: times must increase, got {tuple(times)}.")
    first, middle, axis = _points(eye, target, up)
    axis = normalize(axis)
    position, turn = _pose(first, middle, axis)
    steps = max(math.ceil(abs(turns) * POSES_PER_TURN), 1)
    share = jnp.arange(-_BEYOND, steps + _BEYOND + 1, dtype=position.dtype) / steps
    angle = 2 * jnp.pi * turns * share
    turned = jax.vmap(lambda a: turning(a * axis))(angle)
    offset = product("nij,j->ni", rotation_matrix(turned), position - middle)
    quat = multiply(turned, jnp.broadcast_to(turn, turned.shape))
    time = times[0] + (times[1] - times[0]) * share
    return Trajectory(time, quat, middle[None] + offset, "spline")


def _points(eye: Point, target: Point, up: Point) -> tuple[Array, Array, Array]:
    names = ("eye", "target", "up")
    points = (vector(f"camera.{k}", 3)(x) for k, x in zip(names, (eye, target, up), strict=True))
    eye, target, up = points
    for name, x in zip(names, (eye, target, up), strict=True):
        require(f"camera.{name}", x, np.isfinite, "finite")
    if known(eye, target, up):
        view, vertical = np.asarray(target, float) - np.asarray(eye, float), np.asarray(up, float)
        if not view.any():
            raise ValueError(
                f"camera.eye and camera.target must differ, got {_text(eye)} for both. Move one of "
                "them."
            )
        beside = np.linalg.norm(np.cross(view, vertical))
        if not beside > 1e-6 * np.linalg.norm(view) * np.linalg.norm(vertical):
            raise ValueError(
                f"camera.up must not be zero or along the view from camera.eye to camera.target, "
                f"got eye {_text(eye)}, target {_text(target)}, up {_text(up)}."
            )
    return eye, target, up


def _text(point: Array) -> str:
    """A point as the user would write it."""
    return f"[{', '.join(f'{x:.6g}' for x in point.tolist())}]"


def _pose(eye: Array, target: Array, up: Array) -> tuple[Float[Array, "3"], Float[Array, "4"]]:
    """Position and rotation of a camera, whose axes are +x right, +y down and +z forward."""
    forward = normalize(target - eye)
    right = normalize(jnp.cross(forward, up))
    down = jnp.cross(forward, right)
    return eye, quaternion(jnp.stack([right, down, forward], axis=1))
