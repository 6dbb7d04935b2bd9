"""A scene in space and time: what stands still, what moves, what is there for a short time."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.geometry import inlined
from gaussray.io.plain_values import readable, value_text, vector
from gaussray.io.validate import check_kind
from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import Gaussians, concatenate
from gaussray.scene.residual_field import ResidualField
from gaussray.scene.transient import Transients, transients_at


class Scene(eqx.Module):
    """Gaussians that stand still, Gaussians that a deformation moves, and transient Gaussians.

    Only the moving ones pay for the deformation; a scene in which nothing moves has
    `deformation = None`. A deformation of either kind is a function of the moving Gaussians and a
    time, and has the `instants` between which it was sampled. `transient` are Gaussians that live
    for a short time and move along straight lines (None: there are none). `time_range` is the
    interval of the capture, in the capture's own unit; before and after it the scene rests.
    """

    static: Gaussians
    moving: Gaussians = None  # type: ignore[assignment]  # without any if none are given
    deformation: Deformation | ResidualField | None = None
    time_range: Float[Array, "2"] = eqx.field(
        default=(0.0, 1.0), converter=vector("scene.time_range", 2)
    )
    transient: Transients | None = None

    def __post_init__(self):
        check_kind("scene.static", self.static, Gaussians, "gaussray.Gaussians")
        if self.moving is None:
            self.moving = jax.tree.map(lambda x: x[:0], self.static)

    def __repr__(self) -> str:
        if not eqx.is_array(getattr(self.static, "opacity", None)):
            return readable(self)
        kinds = (
            f"{self.static.count:,} static",
            f"{self.moving.count:,} moving" if self.moving.count else "",
            f"{transient_count(self):,} transient" if transient_count(self) else "",
        )
        by = "" if self.deformation is None else f", {type(self.deformation).__name__}"
        times = value_text(self.time_range)
        return f"Scene({', '.join(filter(None, kinds))} Gaussians{by}, times {times})"

    @property
    def count(self) -> int:
        """How many Gaussians there are of all kinds."""
        return self.static.count + self.moving.count + transient_count(self)


def transient_count(scene: Scene) -> int:
    """How many transient Gaussians a scene has."""
    return 0 if scene.transient is None else scene.transient.count


@inlined
def at(scene: Scene, time: Float[Array, ""]) -> Gaussians:
    """All Gaussians of a scene at one time: static, then moving, then transient ones.

    The opacity of a transient one is its opacity at this time, 0 or nearly 0 for most.

    Args:
        scene: the scene.
        time: in the unit of `scene.time_range`.
    """
    gaussians = persistent_at(scene, time)
    if scene.transient is None:
        return gaussians
    time = jnp.clip(time, scene.time_range[0], scene.time_range[1])
    return concatenate(gaussians, transients_at(scene.transient, time))


def persistent_at(scene: Scene, time: Float[Array, ""]) -> Gaussians:
    """The Gaussians of a scene that are there all the time: static ones first, then moving ones."""
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
    """Number of key states of the deformation for a frame that lasts for `span`.

    Three for every interval between the capture's instants that the frame may touch, so that each
    arc is as short as the motion was sampled. Transient Gaussians need none: their motion is known
    at every time.
    """
    if scene.deformation is None:
        return 1
    instants = np.asarray(scene.deformation.instants)
    if len(instants) < 2:
        return 3
    # Rounding of single precision must not cost an arc.
    intervals = math.ceil(span / float(np.median(np.diff(instants))) - 1e-3)
    return 2 * min(max(intervals, 1), len(instants) - 1) + 1


def _state(gaussians: Gaussians) -> tuple[Array, Array, Array, Array | None]:
    return gaussians.mean, gaussians.quat, gaussians.scale, gaussians.tint
