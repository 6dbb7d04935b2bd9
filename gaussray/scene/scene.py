"""A scene in space and time: what stands still, what moves, and how."""

import math

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import Gaussians, concatenate
from gaussray.scene.residual_field import ResidualField


class Scene(eqx.Module):
    """Gaussians that stand still and Gaussians that a deformation moves.

    Only the moving ones pay for the deformation; a scene in which nothing moves has
    `deformation = None`. A deformation of either kind is a function of the moving Gaussians and a
    time, and has the `instants` between which it was sampled. `time_range` is the interval of the
    capture, in the capture's own unit; beyond it the scene rests.
    """

    static: Gaussians
    moving: Gaussians
    deformation: Deformation | ResidualField | None
    time_range: Float[Array, "2"]


def at(scene: Scene, time: Float[Array, ""]) -> Gaussians:
    """All Gaussians at one time, those that stand still first."""
    if scene.deformation is None:
        return concatenate(scene.static, scene.moving)
    return concatenate(scene.static, scene.deformation(scene.moving, time))


def moving_at(scene: Scene, time: Float[Array, " keys"]) -> Gaussians:
    """The Gaussians that move at several times: mean, quat, scale and tint gain a leading axis.

    Opacity and harmonics, which have none, are those in the middle between the first time and the
    last: exact unless the deformation changes them, and then for a single time.
    """
    deformation = scene.deformation
    if deformation is None:
        raise ValueError("a scene without deformation has no Gaussians that move.")
    mean, quat, scale, tint = jax.vmap(lambda t: _state(deformation(scene.moving, t)))(time)
    middle = deformation(scene.moving, (time[0] + time[-1]) / 2)
    return Gaussians(mean, quat, scale, middle.opacity, middle.harmonics, tint)


def key_count(scene: Scene, span: float) -> int:
    """Key states for a frame that lasts for `span`: three for every interval between the capture's
    instants that it may touch, so that each arc is as short as the motion was sampled."""
    if scene.deformation is None:
        return 1
    instants = np.asarray(scene.deformation.instants)
    if len(instants) < 2:
        return 3
    # Rounding of single precision shall not cost an arc.
    intervals = math.ceil(span / float(np.median(np.diff(instants))) - 1e-3)
    return 2 * min(max(intervals, 1), len(instants) - 1) + 1


def _state(gaussians: Gaussians) -> tuple[Array, Array, Array, Array | None]:
    return gaussians.mean, gaussians.quat, gaussians.scale, gaussians.tint
