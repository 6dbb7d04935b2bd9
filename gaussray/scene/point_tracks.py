"""Tracks of surface points, which move rigidly with a Gaussian."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from gaussray.geometry import product, rotation_matrix
from gaussray.scene.bodies import body_of
from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.residual_field import ResidualField
from gaussray.scene.scene import Scene, transient_count


def point_path(
    scene: Scene, index: Int[Array, ""], point: Float[Array, "3"], time: Float[Array, ""]
) -> Callable[[Float[Array, ""]], Float[Array, "3"]]:
    """Path of a surface point that moves with a Gaussian.

    The point follows the Gaussian's translation and rotation, as on a rigid body, not its scale.
    Points of a transient Gaussian move at its velocity. The deformation is evaluated at every time
    asked for; rendering moves Gaussians along parabolas between key states, which is the same to
    third order.

    Args:
        scene: the scene.
        index: index of the Gaussian, in the order of `scene.at`.
        point: position of the point at `time`, in scene units.
        time: in the capture's unit.

    Returns:
        The position as a function of time.
    """
    velocity = _velocity(scene, index, point)
    if scene.deformation is None or scene.moving.count == 0:
        return lambda other: point + (other - time) * velocity
    first = scene.static.count
    moves = (index >= first) & (index < first + scene.moving.count)
    row = jnp.clip(index - first, 0, scene.moving.count - 1)
    gaussian = jax.tree.map(lambda x: x[row][None], scene.moving)
    deformation = _geometry(scene.deformation)

    def pose(time: Array) -> tuple[Array, Array]:
        state: Gaussians = deformation(gaussian, time)
        return state.mean[0], rotation_matrix(state.quat[0])

    mean, rotation = pose(time)
    local = product("ji,j->i", rotation, point - mean)

    def path(other: Float[Array, ""]) -> Float[Array, "3"]:
        mean, rotation = pose(other)
        straight = point + (other - time) * velocity
        return jnp.where(moves, mean + product("ij,j->i", rotation, local), straight)

    return path


def _velocity(scene: Scene, index: Int[Array, ""], point: Float[Array, "3"]) -> Float[Array, "3"]:
    """Velocity of a transient Gaussian; 0 for all others."""
    first = scene.static.count + scene.moving.count
    if scene.transient is None or not scene.transient.count:
        return jnp.zeros_like(point)
    row = jnp.clip(index - first, 0, scene.transient.count - 1)
    return jnp.where(index >= first, scene.transient.velocity[row], 0)


# Groups of Gaussians; body b is FREE + 1 + b.
STATIC, FREE = 1, 2


def group_of(scene: Scene) -> Int[Array, " gaussians"]:
    """Group of every Gaussian: 1 is static, 2 moves but belongs to no rigid
    body (deforms or is transient), 3 + b is rigid body b."""
    transient = jnp.full(transient_count(scene), FREE, jnp.int32)
    return jnp.concatenate([_persistent_groups(scene), transient])


def _persistent_groups(scene: Scene) -> Int[Array, " gaussians"]:
    static = jnp.full(scene.static.count, STATIC, jnp.int32)
    if scene.deformation is None:
        return jnp.concatenate([static, jnp.full(scene.moving.count, STATIC, jnp.int32)])
    if not isinstance(scene.deformation, Deformation):
        return jnp.concatenate([static, jnp.full(scene.moving.count, FREE, jnp.int32)])
    bodies = scene.deformation.bodies
    body = body_of(bodies, scene.moving.mean)
    group = jnp.where(body == bodies.pivot.shape[0], FREE, FREE + 1 + body)
    return jnp.concatenate([static, group.astype(jnp.int32)])


def _geometry(deformation: Deformation | ResidualField) -> Deformation | ResidualField:
    """The deformation reduced to its translation and rotation, for any subset of the Gaussians."""
    if isinstance(deformation, ResidualField):
        return dataclasses.replace(
            deformation, scale=None, opacity=None, harmonics=None, logit_opacity=None, encoded=False
        )
    return dataclasses.replace(deformation, scale=None, tint=None)
