"""Points of matter: fixed to a Gaussian, they go where it goes."""

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


def carried(
    scene: Scene, index: Int[Array, ""], point: Float[Array, "3"], time: Float[Array, ""]
) -> Callable[[Float[Array, ""]], Float[Array, "3"]]:
    """The path (time -> place) of the point of matter that is at `point` at `time` and fixed to the
    Gaussian `index` (of those of `scene.at`): it shares its way and its turn, as on a rigid body,
    not its stretch.

    What stands still stays. A transient Gaussian carries its points at its velocity. The
    deformation itself is asked, at any time; a picture moves the Gaussians along parabolas between
    key states of it, which is the same to third order.
    """
    velocity = _velocity(scene, index, point)
    if scene.deformation is None or scene.moving.count == 0:
        return lambda other: point + (other - time) * velocity
    still = scene.static.count
    moves = (index >= still) & (index < still + scene.moving.count)
    place = jnp.clip(index - still, 0, scene.moving.count - 1)
    one = jax.tree.map(lambda x: x[place][None], scene.moving)
    deformation = _geometry(scene.deformation)

    def pose(time: Array) -> tuple[Array, Array]:
        state: Gaussians = deformation(one, time)
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
    place = jnp.clip(index - first, 0, scene.transient.count - 1)
    return jnp.where(index >= first, scene.transient.velocity[place], 0)


# What a Gaussian belongs to; bodies follow, FREE + 1 and so on.
STATIC, FREE = 1, 2


def group_of(scene: Scene) -> Int[Array, " gaussians"]:
    """Group of every Gaussian: 1 stands still, 2 moves by itself (bends, or is transient), 3 + b
    is body b."""
    transient = jnp.full(transient_count(scene), FREE, jnp.int32)
    return jnp.concatenate([_persistent_groups(scene), transient])


def _persistent_groups(scene: Scene) -> Int[Array, " gaussians"]:
    still = jnp.full(scene.static.count, STATIC, jnp.int32)
    if scene.deformation is None:
        return jnp.concatenate([still, jnp.full(scene.moving.count, STATIC, jnp.int32)])
    if not isinstance(scene.deformation, Deformation):
        return jnp.concatenate([still, jnp.full(scene.moving.count, FREE, jnp.int32)])
    bodies = scene.deformation.bodies
    body = body_of(bodies, scene.moving.mean)
    group = jnp.where(body == bodies.pivot.shape[0], FREE, FREE + 1 + body)
    return jnp.concatenate([still, group.astype(jnp.int32)])


def _geometry(deformation: Deformation | ResidualField) -> Deformation | ResidualField:
    """What a deformation does to places and turns alone, for any choice of the Gaussians."""
    if isinstance(deformation, ResidualField):
        return dataclasses.replace(
            deformation, scale=None, opacity=None, harmonics=None, logit_opacity=None, encoded=False
        )
    return dataclasses.replace(deformation, scale=None, tint=None)
