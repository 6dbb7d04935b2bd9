"""What is learnt, how fast: Adam with a rate and a schedule for every kind of parameter."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from gaussray.camera.corrections import REFINABLE, Corrections, refined_kinds
from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import Unconstrained, constrain
from gaussray.scene.scene import Scene


# 3DGS's epsilon: gradients of single Gaussians are tiny and must not be damped.
ADAM = optax.scale_by_adam(eps=1e-15)


_OF_BODIES = ("pivot", "radius", "time", "path", "turn")


class Parameters(eqx.Module):
    """Everything the optimiser moves, in unconstrained values."""

    static: Unconstrained
    moving: Unconstrained
    deformation: Deformation | None
    corrections: Corrections | None = None


def scene_of(parameters: Parameters, time_range: Float[Array, "2"]) -> Scene:
    """The scene that the parameters stand for."""
    return Scene(
        static=constrain(parameters.static),
        moving=constrain(parameters.moving),
        deformation=parameters.deformation,
        time_range=time_range,
    )


class OptimizerOptions(eqx.Module):
    """Learning rates at the start of a stage; those of means, of the bodies' paths and of `motion`
    (the last layer of the network's head for means) are multiplied by the extent: they are lengths.

    `decay` is the share of every rate that is left at the end of a stage (exponential schedule);
    everything follows it. `pose`, `lens`, `shutter`, `exposure` and `offset` are for `Corrections`
    of cameras, in their units: largest in the middle of a stage, to which they rise from 0.
    """

    mean: float = eqx.field(static=True, default=1e-3)
    quat: float = eqx.field(static=True, default=1e-2)
    scale: float = eqx.field(static=True, default=2e-2)
    opacity: float = eqx.field(static=True, default=0.05)
    color: float = eqx.field(static=True, default=2e-2)
    harmonics: float = eqx.field(static=True, default=5e-4)
    path: float = eqx.field(static=True, default=6e-3)
    turn: float = eqx.field(static=True, default=3e-2)
    light: float = eqx.field(static=True, default=2e-2)
    planes: float = eqx.field(static=True, default=1e-2)
    network: float = eqx.field(static=True, default=1e-3)
    motion: float = eqx.field(static=True, default=2.5e-4)
    pose: float = eqx.field(static=True, default=3e-4)
    lens: float = eqx.field(static=True, default=3e-4)
    shutter: float = eqx.field(static=True, default=3e-2)
    exposure: float = eqx.field(static=True, default=5e-3)
    offset: float = eqx.field(static=True, default=2e-2)
    decay: float = eqx.field(static=True, default=0.03)

    def __check_init__(self):
        for name in (
            "mean",
            "quat",
            "scale",
            "opacity",
            "color",
            "harmonics",
            "path",
            "turn",
            "light",
            "planes",
            "network",
            "motion",
            *REFINABLE,
        ):
            if getattr(self, name) < 0:
                raise ValueError(f"optimizer.{name} must be at least 0, got {getattr(self, name)}.")
        if not 0 < self.decay <= 1:
            raise ValueError(f"optimizer.decay must be in (0, 1], got {self.decay}.")


def rates(
    parameters: Parameters,
    step: Int[Array, ""],
    *,
    options: OptimizerOptions,
    extent: float | Float[Array, ""],
    steps: int | Int[Array, ""],
    refine: tuple[str, ...] = (),
    formed: bool = False,
    rise: int = 0,
) -> Parameters:
    """Learning rate of every array at a step, as a tree of the parameters' shape. Corrections of
    cameras rest unless `refine` names them. Gaussians that stand still and are `formed` by an
    earlier stage learn at the rate with which that ended. Harmonics of degree n rest for the first
    n x `rise` steps."""
    steps = jnp.maximum(steps, 1)
    fall = options.decay ** (step / steps)

    def gaussians(free: Unconstrained, fall: Array) -> Unconstrained:
        # The constant harmonic is the colour; the others learn more slowly.
        degree = np.floor(np.sqrt(np.arange(free.harmonics.shape[1])))[None, :, None]
        color = jnp.where(degree == 0, options.color, options.harmonics) * fall
        color = jnp.where(degree * rise <= step, color, 0)
        rate = {
            "mean": options.mean * extent * fall,
            "quat": options.quat * fall,
            "log_scale": options.scale * fall,
            "logit_opacity": options.opacity * fall,
            "harmonics": color,
        }
        # Not the constructor: one number stands for a whole array.
        return eqx.tree_at(lambda f: tuple(getattr(f, n) for n in rate), free, tuple(rate.values()))

    deformation = None
    if parameters.deformation is not None:
        deformation = jax.tree.map(lambda _: options.network * fall, parameters.deformation)
        planes = jax.tree.map(lambda _: options.planes * fall, parameters.deformation.planes)
        fixed = (jnp.zeros_like(fall),) * 4
        planes = eqx.tree_at(lambda p: (p.lower, p.upper, p.begin, p.end), planes, fixed)
        bodies = (fixed[0],) * 3 + (options.path * extent * fall, options.turn * fall)
        deformation = eqx.tree_at(
            lambda d: (d.planes, *(getattr(d.bodies, name) for name in _OF_BODIES)),
            deformation,
            (planes, *bodies),
        )
        deformation = eqx.tree_at(lambda d: d.light, deformation, options.light * fall)
        if parameters.deformation.mean is not None:
            motion = options.motion * extent * fall
            deformation = eqx.tree_at(
                lambda d: (d.mean[1].weight, d.mean[1].bias), deformation, (motion, motion)
            )
    static = gaussians(parameters.static, jnp.full_like(fall, options.decay) if formed else fall)
    moving = gaussians(parameters.moving, fall)
    corrections, held = parameters.corrections, refined_kinds(parameters.corrections)
    if held:
        # A scene that has not formed yet would lead them astray.
        half = 2 * step / steps
        late = jnp.minimum(half, 1) * options.decay ** jnp.maximum(half - 1, 0)
        kinds = {kind: getattr(options, kind) * late * (kind in refine) for kind in held}
        corrections = eqx.tree_at(
            lambda c: tuple(getattr(c, kind) for kind in kinds), corrections, tuple(kinds.values())
        )
    return Parameters(static, moving, deformation, corrections)


def descend(
    parameters: Parameters,
    gradient: Parameters,
    adam: optax.ScaleByAdamState,
    rate: Parameters,
) -> tuple[Parameters, optax.ScaleByAdamState]:
    """One step of Adam, every array at its own rate, where there is a gradient at all.

    What a step does not see (Gaussians out of view, poses and rows of other instants) rests,
    moments included. Otherwise momentum would carry it on blindly, and its second moment would fade
    until the next gradient throws it several rates far.
    """
    direction, moments = ADAM.update(gradient, adam)  # type: ignore[arg-type]
    seen = jax.tree.map(lambda g: g != 0, gradient)

    def where_seen(new: Parameters, old: Parameters) -> Parameters:
        return jax.tree.map(jnp.where, seen, new, old)

    moved = jax.tree.map(
        lambda p, d, r, s: jnp.where(s, p - r * d, p).astype(p.dtype),
        parameters,
        direction,
        rate,
        seen,
    )
    kept = optax.ScaleByAdamState(
        moments.count,  # type: ignore[attr-defined]
        mu=where_seen(moments.mu, adam.mu),  # type: ignore
        nu=where_seen(moments.nu, adam.nu),  # type: ignore
    )
    return moved, kept
