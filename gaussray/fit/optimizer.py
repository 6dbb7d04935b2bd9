"""What is learnt, how fast: Adam with a learning rate and a schedule for every kind of parameter."""

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import Unconstrained, constrain
from gaussray.scene.scene import Scene


# 3DGS's epsilon: gradients of single Gaussians are tiny and must not be damped.
ADAM = optax.scale_by_adam(eps=1e-15)


class Parameters(eqx.Module):
    """Everything the optimiser moves, in unconstrained values."""

    static: Unconstrained
    moving: Unconstrained
    deformation: Deformation | None


def scene_of(parameters: Parameters, time_range: Float[Array, "2"]) -> Scene:
    """The scene that the parameters stand for."""
    return Scene(
        static=constrain(parameters.static),
        moving=constrain(parameters.moving),
        deformation=parameters.deformation,
        time_range=time_range,
    )


class OptimizerOptions(eqx.Module):
    """Learning rates at the start of a stage; that of the means is multiplied by the extent.

    `decay` is the share of every rate that is left at the end of a stage (exponential schedule);
    everything follows it.
    """

    mean: float = eqx.field(static=True, default=1e-3)
    quat: float = eqx.field(static=True, default=4e-3)
    scale: float = eqx.field(static=True, default=1e-2)
    opacity: float = eqx.field(static=True, default=0.05)
    color: float = eqx.field(static=True, default=1e-2)
    harmonics: float = eqx.field(static=True, default=5e-4)
    planes: float = eqx.field(static=True, default=1e-2)
    network: float = eqx.field(static=True, default=2e-3)
    decay: float = eqx.field(static=True, default=0.1)

    def __check_init__(self):
        for name in ("mean", "quat", "scale", "opacity", "color", "harmonics", "planes", "network"):
            if getattr(self, name) < 0:
                raise ValueError(f"optimizer.{name} must be at least 0, got {getattr(self, name)}.")
        if not 0 < self.decay <= 1:
            raise ValueError(f"optimizer.decay must be in (0, 1], got {self.decay}.")


def rates(
    parameters: Parameters,
    step: Int[Array, ""],
    *,
    options: OptimizerOptions,
    extent: float,
    steps: int,
) -> Parameters:
    """Learning rate of every array at a step, as a tree of the parameters' shape."""
    fall = optax.exponential_decay(1.0, max(steps, 1), options.decay)(step)

    def gaussians(free: Unconstrained) -> Unconstrained:
        # The constant harmonic is the colour; the others learn more slowly.
        coefficients = jnp.arange(free.harmonics.shape[1])[None, :, None]
        color = jnp.where(coefficients == 0, options.color, options.harmonics) * fall
        return Unconstrained(
            mean=options.mean * extent * fall,
            quat=options.quat * fall,
            log_scale=options.scale * fall,
            logit_opacity=options.opacity * fall,
            harmonics=color,
        )

    deformation = None
    if parameters.deformation is not None:
        deformation = jax.tree.map(lambda _: options.network * fall, parameters.deformation)
        planes = jax.tree.map(lambda _: options.planes * fall, parameters.deformation.planes)
        fixed = (jnp.zeros_like(fall),) * 4
        planes = eqx.tree_at(lambda p: (p.lower, p.upper, p.begin, p.end), planes, fixed)
        deformation = eqx.tree_at(lambda d: d.planes, deformation, planes)
    return Parameters(gaussians(parameters.static), gaussians(parameters.moving), deformation)


def descend(
    parameters: Parameters,
    gradient: Parameters,
    adam: optax.OptState,
    rate: Parameters,
) -> tuple[Parameters, optax.OptState]:
    """One step of Adam, every array at its own rate."""
    direction, adam = ADAM.update(gradient, adam)
    moved = jax.tree.map(lambda p, d, r: (p - r * d).astype(p.dtype), parameters, direction, rate)
    return moved, adam
