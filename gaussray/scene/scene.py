"""A dynamic scene: static Gaussians, deformed Gaussians and transient Gaussians."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.geometry import inlined
from gaussray.io.plain_values import readable, value_text, vector
from gaussray.io.validate import check_kind, require
from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import Gaussians, concatenate
from gaussray.scene.light import Light
from gaussray.scene.residual_field import ResidualField
from gaussray.scene.shading import Shading
from gaussray.scene.transient import Transients, transients_at


# Of an interval between timestamps: rounding of single precision must not cost an arc of key
# states; times that differ by less are one.
_ARC_ROUNDING, _ONE_TIME = 1e-3, 1e-6


class Scene(eqx.Module):
    """A dynamic scene of three kinds of Gaussians.

    Args:
        static: Gaussians that do not move.
        moving: Gaussians that the deformation moves; by default none.
        deformation: a function of the moving Gaussians and a time; None if nothing moves.
        time_range: first and last time of the capture, in the capture's unit; before and after it
            nothing moves.
        transient: Gaussians that live for a short time and move along straight lines; None for
            none.
        light: light that changes over time; None for light that does not.
        shading: shadows and reflected light that pass over static Gaussians; None for none.

    Raises:
        ValueError: `static` is of another type, or a time is not finite or out of order.
    """

    static: Gaussians
    moving: Gaussians = None  # type: ignore[assignment]  # without any if none are given
    deformation: Deformation | ResidualField | None = None
    time_range: Float[Array, "2"] = eqx.field(
        default=(0.0, 1.0), converter=vector("scene.time_range", 2)
    )
    transient: Transients | None = None
    light: Light | None = None
    shading: Shading | None = None

    def __post_init__(self):
        check_kind("scene.static", self.static, Gaussians, "gaussray.Gaussians")
        if self.moving is None:
            self.moving = jax.tree.map(lambda x: x[:0], self.static)

    def __check_init__(self):
        require(
            "scene.time_range",
            self.time_range,
            lambda t: np.isfinite(t).all() & np.all(t[..., 0] <= t[..., 1]),
            "a finite first time and a last one that is not before it",
        )

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
        """Number of Gaussians of all kinds."""
        return self.static.count + self.moving.count + transient_count(self)


def transient_count(scene: Scene) -> int:
    """Number of transient Gaussians of a scene."""
    return 0 if scene.transient is None else scene.transient.count


@inlined
def at(scene: Scene, time: Float[Array, ""]) -> Gaussians:
    """All Gaussians of a scene at one time: static, then moving, then transient ones.

    The opacity of a transient one is its opacity at this time, 0 or nearly 0 for most. Their
    colours are those in the light of this time.

    Args:
        scene: the scene.
        time: in the unit of `scene.time_range`.
    """
    gaussians = persistent_at(scene, time)
    if scene.transient is not None:
        now = jnp.clip(time, scene.time_range[0], scene.time_range[1])
        gaussians = concatenate(gaussians, transients_at(scene.transient, now))
    return gaussians if scene.light is None else scene.light.applied_to(gaussians, time)


def persistent_at(scene: Scene, time: Float[Array, ""], *, held: bool = False) -> Gaussians:
    """The static and the moving Gaussians of a scene at a time, in this order, in usual light.

    Args:
        scene: the scene.
        time: in the unit of `scene.time_range`.
        held: what derivatives leave out (`deform`).
    """
    static = static_at(scene, time, held=held)
    if scene.deformation is None:
        return concatenate(static, scene.moving)
    return concatenate(static, scene.deformation(scene.moving, time, held=held))


def static_at(scene: Scene, time: Float[Array, ""], *, held: bool = False) -> Gaussians:
    """The static Gaussians of a scene in the shade of a time, in usual light.

    Args:
        scene: the scene.
        time: in the unit of `scene.time_range`.
        held: whether derivatives leave out how the shade depends on places.
    """
    if scene.shading is None:
        return scene.static
    return scene.shading.applied_to(scene.static, time, held=held)


def moving_at(scene: Scene, time: Float[Array, " keys"], *, held: bool = False) -> Gaussians:
    """The moving Gaussians at several times: mean, quat, scale and tint gain a leading axis.

    Opacity and harmonics are those in the middle between the first and the last time. This is exact
    unless the deformation changes them.

    Args:
        scene: the scene.
        time: increasing times, in the unit of `scene.time_range`.
        held: what derivatives leave out (`deform`).

    Raises:
        ValueError: The scene has no deformation.
    """
    if scene.deformation is None:
        raise ValueError("a scene without deformation has no Gaussians that move.")
    deformed = functools.partial(scene.deformation, scene.moving, held=held)
    mean, quat, scale, tint = jax.vmap(lambda t: _state(deformed(t)))(time)
    middle = deformed((time[0] + time[-1]) / 2)
    return Gaussians(mean, quat, scale, middle.opacity, middle.harmonics, tint)


def key_count(scene: Scene, span: float) -> int:
    """Number of key states of the deformation for one frame.

    There are three for every interval between timestamps that the frame may touch, so that each arc
    is as short as the motion was sampled. Transient Gaussians need none.

    Args:
        scene: the scene.
        span: time from the first to the last ray of the frame, in the capture's unit.
    """
    if scene.deformation is None:
        return 1
    instants = np.asarray(scene.deformation.instants)
    if len(instants) < 2:
        return 3
    return int(_states(span / np.median(np.diff(instants)), len(instants) - 1, np))


def key_count_of(scene: Scene, span: Float[Array, ""]) -> Int[Array, ""]:
    """`key_count` of a frame whose duration is known in a program alone; 1 for one without.

    Args:
        scene: the scene.
        span: time from the first to the last ray of the frame, in the capture's unit.
    """
    if scene.deformation is None:
        return jnp.ones((), jnp.int32)
    instants = scene.deformation.instants
    if len(instants) < 2:
        return jnp.where(span > 0, 3, 1)
    share = span / jnp.median(jnp.diff(instants))
    states = _states(share, len(instants) - 1, jnp)
    # Times that differ by rounding alone are one.
    return jnp.where(share > _ONE_TIME, states, 1).astype(jnp.int32)


def _states(share: Any, intervals: int, module: Any) -> Any:
    """Key states of a duration in intervals between timestamps, of which there are so many, by
    NumPy on the host or by JAX."""
    return 2 * module.clip(module.ceil(share - _ARC_ROUNDING), 1, intervals) + 1


def _state(gaussians: Gaussians) -> tuple[Array, Array, Array, Array | None]:
    return gaussians.mean, gaussians.quat, gaussians.scale, gaussians.tint
