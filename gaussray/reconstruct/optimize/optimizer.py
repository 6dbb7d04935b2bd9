"""What is learnt, and the steps of Adam that learn it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from gaussray.camera.corrections import Corrections
from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import Unconstrained, constrain
from gaussray.scene.scene import Scene
from gaussray.scene.shading import Shading
from gaussray.scene.transient import (
    Transients,
    UnconstrainedTransients,
    constrain_transients,
    interval_at,
)


# 3DGS's epsilon: gradients of single Gaussians are tiny and must not be damped.
_SECOND_DECAY = 0.999
ADAM = optax.scale_by_adam(b2=_SECOND_DECAY, eps=1e-15)


class Parameters(eqx.Module):
    """Everything that is learnt, in unconstrained values."""

    static: Unconstrained
    moving: Unconstrained
    deformation: Deformation | None
    corrections: Corrections | None = None
    transient: UnconstrainedTransients | None = None
    shading: Shading | None = None

    @property
    def kinds(self) -> dict[str, Unconstrained | UnconstrainedTransients]:
        """The Gaussians by their kind: static, moving, and transient where there are any."""
        parts: dict[str, Unconstrained | UnconstrainedTransients] = {}
        parts |= {"static": self.static, "moving": self.moving}
        return parts if self.transient is None else parts | {"transient": self.transient}


def shortest_lifetime(
    times: Float[Array, " times"], instant: Float[Array, " gaussians"]
) -> Float[Array, " gaussians"]:
    """Floor of the lifetime of transient Gaussians: half of the interval between pictures there, so
    that the scene stays opaque between them.

    Args:
        times: timestamps of the pictures, increasing.
        instant: the instant of each Gaussian.
    """
    return 0.5 * interval_at(times, instant)


def scene_of(
    parameters: Parameters, time_range: Float[Array, "2"], times: Float[Array, " times"]
) -> Scene:
    """The scene with these parameters.

    Args:
        parameters: unconstrained values.
        time_range: the interval of the capture.
        times: the timestamps of the pictures, on which the lifetimes of transient Gaussians depend.
    """
    transient = parameters.transient
    return Scene(
        static=constrain(parameters.static),
        moving=constrain(parameters.moving),
        deformation=parameters.deformation,
        time_range=time_range,
        transient=None if transient is None else transients_of(transient, times),
        shading=jax.lax.stop_gradient(parameters.shading),
    )


def transients_of(free: UnconstrainedTransients, times: Float[Array, " times"]) -> Transients:
    """The transient Gaussians of unconstrained values.

    Args:
        free: the unconstrained values.
        times: timestamps of the pictures, which bound the lifetimes (`shortest_lifetime`).
    """
    return constrain_transients(free, shortest_lifetime(times, jnp.asarray(free.instant)))


def descend(
    parameters: Parameters,
    gradient: Parameters,
    adam: optax.ScaleByAdamState,
    rate: Parameters,
) -> tuple[Parameters, optax.ScaleByAdamState]:
    """One step of Adam, every array at its own rate, where there is a gradient at all.

    What a step does not see (Gaussians out of view, poses and plane rows of other times) keeps its
    value and its moments. Otherwise momentum would move it without evidence, and its second moment
    would fade until the next gradient moves it by several rates at once.

    Args:
        parameters: what is learnt.
        gradient: gradient of the loss of the pictures; 0: not seen.
        adam: the moments before the step.
        rate: the learning rates (`rates`).

    Returns:
        Parameters and moments after the step.
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


def with_density_costs(
    parameters: Parameters,
    gradient: Parameters,
    adam: optax.ScaleByAdamState,
    rate: Parameters,
) -> Parameters:
    """The parameters after a step down the gradient of what opacity and scale cost, which all
    Gaussians pay in every step, seen or not.

    The gradient is divided by the root of the second moment of the pictures' gradient, as Adam
    divides that, so that both weigh as the loss says. It is not part of the moments: where a step
    sees few Gaussians (large pictures, few rays), the cost alone would fill the moments of all
    others, and Adam would let them fade at its full rate between two looks. What no step has seen
    yet pays nothing, and nothing moves by more than its rate.

    Args:
        parameters: what is learnt, after the step of Adam.
        gradient: gradient of the costs (`step_loss.density_costs`).
        adam: the moments after the step of Adam.
        rate: the learning rates (`rates`).
    """
    correction = 1 - _SECOND_DECAY**adam.count
    second_moments: Parameters = adam.nu  # type: ignore[assignment]

    def paid(value: Array, slope: Array, second: Array, own_rate: Array) -> Array:
        size = jnp.sqrt(jnp.where(second > 0, second / correction, 1))
        step = own_rate * jnp.clip(slope / size, -1, 1)
        return jnp.where(second > 0, value - step, value).astype(value.dtype)

    def priced(tree):
        return [x for free in tree.kinds.values() for x in (free.logit_opacity, free.log_scale)]

    rows = zip(*map(priced, (parameters, gradient, second_moments, rate)), strict=True)
    return eqx.tree_at(priced, parameters, [paid(*row) for row in rows])
