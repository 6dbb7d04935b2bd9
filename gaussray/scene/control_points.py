"""Control points: poses of places on a soft surface, which Gaussians nearby follow."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from gaussray.geometry import inlined, normalize_quaternion, product, rotation_matrix
from gaussray.runtime.devices import numba_module, runs_machine_code
from gaussray.scene.bodies import poses_at


# The module of machine code for a CPU.
_CODE = "gaussray.scene.skinning_code"


class ControlPoints(eqx.Module):
    """Poses of control points at increasing times.

    A Gaussian moves with the control points near its place at rest (that of the first timestamp, if
    they were tracked from there): the average of their rigid motions, weighted by
    exp(-d^2 / (2 radius^2)) of the distances d (linear blend skinning; sparse control points, Huang
    et al. 2024). Far from all, the nearest one decides.

    Args:
        pivot: place of each control point at rest, in scene units.
        radius: width of the weights of each, in scene units, above 0.
        time: the times of the poses.
        path: translation of each control point at each of these times, in scene units.
        turn: rotation about the pivot (w, x, y, z) at each of these times, of any non-zero length;
            those of neighbours are averaged, so they lie in one half of the unit sphere.
    """

    pivot: Float[Array, "points 3"]
    radius: Float[Array, " points"]
    time: Float[Array, " instants"]
    path: Float[Array, "points instants 3"]
    turn: Float[Array, "points instants 4"]


@inlined
def skinning_weights(
    points: ControlPoints, position: Float[Array, "gaussians 3"]
) -> Float[Array, "gaussians points"]:
    """Weight of every control point for every Gaussian; those of a Gaussian sum to 1.

    Args:
        points: the control points, at least one.
        position: centres of the Gaussians at rest, in scene units.
    """
    return _weights(points.pivot, points.radius, position)


def _weights(pivot: Array, radius: Array, position: Array) -> Array:
    # From the middle of the points, so that the difference of squares keeps its digits.
    middle = jnp.mean(pivot, axis=0)[None]
    place, pivot = position - middle, pivot - middle
    square = jnp.sum(place**2, axis=1)[:, None] + jnp.sum(pivot**2, axis=1)[None]
    square = jnp.maximum(square - 2 * product("nd,md->nm", place, pivot), 0)
    return jax.nn.softmax(-square / (2 * radius**2)[None], axis=1)


def skinned(
    pivot: Float[Array, "points 3"],
    radius: Float[Array, " points"],
    position: Float[Array, "gaussians 3"],
    table: Float[Array, "points columns"],
) -> Float[Array, "gaussians columns"]:
    """Rows of a table, blended with the weights of the control points (`skinning_weights`).

    In single precision on a CPU by machine code (`skinning_code`).

    Args:
        pivot: places of the control points, in scene units.
        radius: widths of their weights, in scene units.
        position: centres of the Gaussians at rest, in scene units.
        table: a row for each control point.
    """
    single = all(x.dtype == jnp.float32 for x in (pivot, radius, position, table))
    # Machine code does not look whether arrays fit; for one Gaussian see `planes.plane_product`.
    fits = len(table) == len(pivot) > 0 and radius.shape == pivot.shape[:1]
    if single and fits and len(position) > 1 and runs_machine_code():
        return _native_blend(pivot, radius, position, table)
    return _array_blend(pivot, radius, position, table)


def _array_blend(pivot: Array, radius: Array, position: Array, table: Array) -> Array:
    return product("nm,mc->nc", _weights(pivot, radius, position), table)


def _blend(pivot: Array, radius: Array, position: Array, table: Array) -> Array:
    return numba_module(_CODE).blended_on_cpu(pivot, radius, position, table)


def _blend_saved(pivot, radius, position, table):
    # The structure tells whether weights have a gradient, as values would be traced.
    weighs = () if any(x.perturbed for x in (pivot, radius, position)) else None
    arrays = pivot.value, radius.value, position.value, table.value
    return _blend(*arrays), (arrays, weighs)


def _blend_backward(saved, g):
    arrays, weighs = saved
    if isinstance(g, SymbolicZero):
        return None, None, None, None
    if weighs is not None:
        return jax.vjp(_array_blend, *arrays)[1](g)
    pivot, radius, position, _ = arrays
    gradient = numba_module(_CODE).table_gradient_on_cpu(pivot, radius, position, g)
    return None, None, None, gradient


_native_blend = jax.custom_vjp(_blend)
_native_blend.defvjp(_blend_saved, _blend_backward, symbolic_zeros=True)


@inlined
def control_motion(
    points: ControlPoints, position: Float[Array, "gaussians 3"], time: Float[Array, ""]
) -> tuple[Float[Array, "gaussians 3"], Float[Array, "gaussians 4"]]:
    """Displacement and rotation (a unit quaternion) of every Gaussian at a time.

    Between the times of the poses, these are interpolated as those of rigid bodies
    (`bodies.poses_at`).

    Args:
        points: the control points, at least one.
        position: centres of the Gaussians at rest, in scene units.
        time: in the capture's unit.
    """
    path, turn = poses_at(points.time, points.path, points.turn, time)
    rotation = rotation_matrix(turn)
    change = rotation - jnp.eye(3, dtype=rotation.dtype)[None]
    # A place x goes to x + path + (R - 1) (x - pivot).
    middle = jnp.mean(points.pivot, axis=0)
    shift = path - product("mij,mj->mi", change, points.pivot - middle[None])
    # All that is blended, in one product.
    table = jnp.concatenate([shift, change.reshape(-1, 9), turn], axis=1)
    blend = skinned(points.pivot, points.radius, position, table)
    shift, change, turn = jnp.split(blend, [3, 12], axis=1)
    turned = product("nij,nj->ni", change.reshape(-1, 3, 3), position - middle[None])
    return shift + turned, normalize_quaternion(turn)


def with_fixed_weights(points: ControlPoints) -> ControlPoints:
    """The same control points, whose pivots and radii get no gradient: that of the weights would
    take as long as all the rest of a step.
    """
    fixed = jax.lax.stop_gradient((points.pivot, points.radius))
    return eqx.tree_at(lambda p: (p.pivot, p.radius), points, fixed)
