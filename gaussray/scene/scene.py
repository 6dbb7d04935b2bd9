"""A scene in space and time: what stands still, what moves, and how."""

import equinox as eqx
import jax
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


def moving_at(scene: Scene, time: Float[Array, " keys"]) -> Gaussians:
    """The Gaussians that move at several times: mean, quat, scale and tint gain a leading axis."""
    deformation = scene.deformation
    if deformation is None:
        raise ValueError("a scene without deformation has no Gaussians that move.")
    mean, quat, scale, tint = jax.vmap(lambda t: _state(deform(scene.moving, deformation, t)))(time)
    return Gaussians(mean, quat, scale, scene.moving.opacity, scene.moving.harmonics, tint)


def _state(gaussians: Gaussians) -> tuple[Array, Array, Array, Array | None]:
    return gaussians.mean, gaussians.quat, gaussians.scale, gaussians.tint
