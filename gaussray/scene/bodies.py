"""Rigid bodies: a translation and a rotation over time for each."""

from typing import Protocol, TypeVar, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from gaussray.geometry import inlined, normalize_quaternion, product


@runtime_checkable
class HasPoses(Protocol):
    """Things with poses at timestamps: bodies or control points."""

    @property
    def time(self) -> Float[Array, " instants"]: ...
    @property
    def path(self) -> Float[Array, "bodies instants 3"]: ...
    @property
    def turn(self) -> Float[Array, "bodies instants 4"]: ...


Poses = TypeVar("Poses", bound=HasPoses)


class Bodies(eqx.Module):
    """Poses of rigid bodies at the timestamps of a capture.

    A body holds the Gaussians within `radius` of its `pivot` (of several bodies in reach, the one
    with the nearest pivot). Gaussians of no body do not move.

    Args:
        pivot: centre of rotation of each body, in scene units.
        radius: radius of each body, in scene units.
        time: the timestamps.
        path: translation of each body at each timestamp, in scene units.
        turn: rotation about the pivot (w, x, y, z) at each timestamp, of any non-zero length.
    """

    pivot: Float[Array, "bodies 3"]
    radius: Float[Array, " bodies"]
    time: Float[Array, " instants"]
    path: Float[Array, "bodies instants 3"]
    turn: Float[Array, "bodies instants 4"]


def bodies_at_rest(
    pivot: Float[Array, "bodies 3"],
    radius: Float[Array, " bodies"],
    time: Float[Array, " instants"],
) -> Bodies:
    """Bodies whose poses are the identity at all timestamps.

    Args:
        pivot: centre of rotation of each body, in scene units.
        radius: radius of each body, in scene units.
        time: the timestamps.
    """
    count, instants = pivot.shape[0], time.shape[0]
    turn = jnp.zeros((count, instants, 4), pivot.dtype).at[..., 0].set(1)
    return Bodies(pivot, radius, time, jnp.zeros((count, instants, 3), pivot.dtype), turn)


def extrapolate_bodies(bodies: Poses, earlier: float, later: float) -> Poses:
    """The same bodies, or control points, with a pose before the first timestamp and one after the
    last.

    There they move on at constant speed.

    Args:
        bodies: the bodies; with a single timestamp they are returned as they are.
        earlier: time of the new first pose before the first timestamp; 0 adds none.
        later: time of the new last pose after the last timestamp; 0 adds none.
    """
    values = bodies.time[None], bodies.path, bodies.turn
    if values[0].shape[1] < 2:
        return bodies
    for end, inner, by in ((0, 1, earlier), (-1, -2, later)):
        if by > 0:
            share = by / abs(float(values[0][0, end] - values[0][0, inner]))
            onward = [x[:, end] + share * (x[:, end] - x[:, inner]) for x in values]
            pairs = [(x, n[:, None].astype(x.dtype)) for x, n in zip(values, onward, strict=True)]
            values = [jnp.concatenate(p if end else p[::-1], axis=1) for p in pairs]
    time, path, turn = values
    return eqx.tree_at(lambda b: (b.time, b.path, b.turn), bodies, (time[0], path, turn))


@inlined
def body_of(bodies: Bodies, position: Float[Array, "gaussians 3"]) -> Int[Array, " gaussians"]:
    """Index of the body that holds each Gaussian, or the number of bodies where none does.

    Args:
        bodies: the bodies.
        position: centres of the Gaussians, in scene units.
    """
    if not bodies.pivot.shape[0]:
        return jnp.zeros(position.shape[0], jnp.int32)
    difference = position[:, None] - bodies.pivot[None]
    square = jnp.sum(difference * difference, axis=-1)
    square = jnp.where(square <= bodies.radius[None] ** 2, square, jnp.inf)
    held = jnp.isfinite(jnp.min(square, axis=1))
    return jnp.where(held, jnp.argmin(square, axis=1), bodies.pivot.shape[0])


@inlined
def body_pose_at(
    bodies: Bodies, time: Float[Array, ""]
) -> tuple[Float[Array, "bodies 3"], Float[Array, "bodies 4"]]:
    """Translation and rotation (a unit quaternion) of every body at a time.

    Cubic through the poses (Catmull-Rom, by three-point differences for uneven timestamps, which
    are exact for parabolas), constant before the first and after the last. The motion is smooth
    between timestamps, so that rows that are read there see the body on its way.

    Args:
        bodies: the bodies.
        time: in the capture's unit.
    """
    return poses_at(bodies.time, bodies.path, bodies.turn, time)


@inlined
def poses_at(
    knots: Float[Array, " instants"],
    path: Float[Array, "bodies instants 3"],
    turn: Float[Array, "bodies instants 4"],
    time: Float[Array, ""],
) -> tuple[Float[Array, "bodies 3"], Float[Array, "bodies 4"]]:
    """Translation and rotation at a time, from those at timestamps (`body_pose_at`).

    Args:
        knots: the timestamps.
        path: translations at the timestamps, in scene units.
        turn: rotations at the timestamps (w, x, y, z), of any non-zero length.
        time: in the capture's unit.
    """
    share = _pose_weights(knots, time)
    shift = product("t,btc->bc", share, path)
    return shift, normalize_quaternion(product("t,btc->bc", share, turn))


def _pose_weights(
    knots: Float[Array, " instants"], time: Float[Array, ""]
) -> Float[Array, " instants"]:
    """Weight of every instant's pose: cubic Hermite, with the slopes of the parabola through an
    instant and its neighbours, at the ends those of the line to the neighbour."""
    count = knots.shape[0]
    if count == 1:
        return jnp.ones_like(knots)
    time = jnp.clip(time, knots[0], knots[-1])
    low = jnp.clip(jnp.searchsorted(knots, time, side="right") - 1, 0, count - 2)
    step = knots[low + 1] - knots[low]
    s = (time - knots[low]) / step
    unit = jnp.eye(count, dtype=knots.dtype)

    def slope(i: Array) -> Array:
        before, after = jnp.maximum(i - 1, 0), jnp.minimum(i + 1, count - 1)
        left, right = knots[i] - knots[before], knots[after] - knots[i]
        # The nearer neighbour tells more of the slope; beyond the ends there is none.
        near = right / (left + right)
        to_left = (unit[i] - unit[before]) / jnp.where(left > 0, left, 1)
        to_right = (unit[after] - unit[i]) / jnp.where(right > 0, right, 1)
        share = jnp.where(left > 0, jnp.where(right > 0, near, 1), 0)
        return share * to_left + (1 - share) * to_right

    return (
        (1 + 2 * s) * (1 - s) ** 2 * unit[low]
        + s * (1 - s) ** 2 * step * slope(low)
        + s * s * (3 - 2 * s) * unit[low + 1]
        + s * s * (s - 1) * step * slope(low + 1)
    )
