"""Regularisers of the deformation: planes smooth in space and steady in time, control points that
move as rigidly as possible."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.geometry import product, rotation_matrix
from gaussray.scene.bodies import poses_at
from gaussray.scene.control_points import ControlPoints
from gaussray.scene.planes import Planes


# Neighbours that a control point holds on to.
_NEIGHBOURS = 6
# Change of the distance to a neighbour, as a share of it, from which on its cost is linear.
_SOFT = 0.01


def plane_terms(planes: Planes) -> dict[str, Float[Array, ""]]:
    """The three plane regularisers of HexPlane and 4DGaussians, unweighted.

    `plane_variation`: mean squared difference of neighbours in the spatial planes (total
    variation). `time_smoothness`: mean squared second difference along time.
    `time_planes_from_one`: mean |1 - time plane|, which pulls towards a field that does not change.
    """
    space = [_squares(p, 1) + _squares(p, 2) for p in planes.space]
    time = [_squares(jnp.diff(p, axis=1), 1) for p in planes.time]
    one = [jnp.mean(jnp.abs(1 - p)) for p in planes.time]
    terms = {"plane_variation": space, "time_smoothness": time, "time_planes_from_one": one}
    return {name: sum(term) for name, term in terms.items()}  # type: ignore[misc]


def rigid_term(control: ControlPoints, time: Float[Array, ""]) -> Float[Array, ""]:
    """How far control points are from moving as rigidly as possible (Sumner et al. 2007), with a
    robust norm: things may slide past each other.

    The mean over all pairs of a control point and one of its nearest neighbours at rest of the
    distance between where the neighbour is and where the pose of the control point would put it,
    as a share of their distance at rest.

    Args:
        control: the control points.
        time: the time at which they are looked at.
    """
    pivot, others = control.pivot, min(_NEIGHBOURS, control.pivot.shape[0] - 1)
    if others < 1:
        return jnp.zeros((), pivot.dtype)
    path, turn = poses_at(control.time, control.path, control.turn, time)
    square = jnp.sum((pivot[:, None] - pivot[None]) ** 2, axis=-1)
    near, index = jax.lax.top_k(-square, others + 1)
    index, square = index[:, 1:], -near[:, 1:]
    arm = pivot[index] - pivot[:, None]
    change = rotation_matrix(turn) - jnp.eye(3, dtype=turn.dtype)[None]
    expected = path[:, None] + product("nij,nkj->nki", change, arm)
    off = jnp.sum((path[index] - expected) ** 2, axis=-1)
    off = off / jnp.where(square > 0, square, 1)
    return jnp.mean(jnp.sqrt(off + _SOFT**2) - _SOFT)


def _squares(x: Array, axis: int) -> Array:
    difference = jnp.diff(x, axis=axis)
    return jnp.sum(difference * difference) / max(difference.size, 1)
