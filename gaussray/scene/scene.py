"""A scene in space and time: what stands still, what moves, and how."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.scene.deformation import Deformation, deform
from gaussray.scene.gaussians import Gaussians, concatenate


class Scene(eqx.Module):
    """Gaussians that stand still and Gaussians that a deformation moves.

    Only the moving ones pay for the deformation; a scene in which nothing moves has
    `deformation = None`. `time_range` is the interval of the capture, in the capture's own unit;
    beyond it the scene rests.
    """

    static: Gaussians
    moving: Gaussians
    deformation: Deformation | None
    time_range: Float[Array, "2"]


def at(scene: Scene, time: Float[Array, ""]) -> Gaussians:
    """All Gaussians at one time, those that stand still first."""
    if scene.deformation is None:
        return concatenate(scene.static, scene.moving)
    return concatenate(scene.static, deform(scene.moving, scene.deformation, time))


def at_times(scene: Scene, time: Float[Array, " keys"]) -> Gaussians:
    """All Gaussians at several times: mean, quat, scale and tint gain a leading axis."""
    if scene.deformation is None:
        still = concatenate(scene.static, scene.moving)
        return _keyed(still, time.shape[0])
    deformation = scene.deformation
    mean, quat, scale, tint = jax.vmap(lambda t: _state(deform(scene.moving, deformation, t)))(time)
    moved = Gaussians(mean, quat, scale, scene.moving.opacity, scene.moving.harmonics, tint)
    return concatenate(scene.static, moved)


def _state(gaussians: Gaussians) -> tuple[Array, Array, Array, Array | None]:
    return gaussians.mean, gaussians.quat, gaussians.scale, gaussians.tint


def _keyed(gaussians: Gaussians, keys: int) -> Gaussians:
    state = jax.tree.map(lambda x: jnp.broadcast_to(x, (keys, *x.shape)), _state(gaussians))
    mean, quat, scale, tint = state
    return Gaussians(mean, quat, scale, gaussians.opacity, gaussians.harmonics, tint)
