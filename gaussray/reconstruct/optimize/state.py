"""The state of the optimiser: what a training step reads and returns."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int

from gaussray.reconstruct.optimize.gradient_statistic import (
    GradientStatistic,
    accumulate,
    no_gradient,
)
from gaussray.reconstruct.optimize.optimizer import ADAM, Parameters
from gaussray.scene.gaussians import Unconstrained
from gaussray.scene.transient import UnconstrainedTransients


class State(eqx.Module):
    """The state of the optimiser.

    Args:
        parameters: what is learnt.
        adam: Adam's moments.
        static_statistic: gradients of static Gaussians, which density control reads.
        moving_statistic: those of moving Gaussians.
        step: steps of the stage that are done.
        transient_statistic: those of transient Gaussians; None if there are none.
    """

    parameters: Parameters
    adam: optax.ScaleByAdamState
    static_statistic: GradientStatistic
    moving_statistic: GradientStatistic
    step: Int[Array, ""]
    transient_statistic: GradientStatistic | None = None


@eqx.filter_jit
def begin_state(parameters: Parameters) -> State:
    """The state before the first step of a stage: moments and statistics are zero."""
    transient = parameters.transient
    return State(
        parameters,
        ADAM.init(parameters),  # type: ignore[arg-type]
        no_gradient(parameters.static.logit_opacity.shape[0]),
        no_gradient(parameters.moving.logit_opacity.shape[0]),
        jnp.zeros((), jnp.int32),
        None if transient is None else no_gradient(transient.logit_opacity.shape[0]),
    )


def accumulated_statistics(
    state: State, gradient: Parameters, eye: Float[Array, "rays 3"]
) -> tuple[GradientStatistic, GradientStatistic, GradientStatistic | None]:
    """The gradient statistics of static, moving and transient Gaussians after one more step.

    Args:
        state: the state before the step.
        gradient: gradient of the step's loss.
        eye: origins of the step's rays, in the world.
    """
    center = jnp.mean(eye, axis=0)
    spread = jnp.mean(jnp.sum((eye - center[None]) ** 2, axis=-1))

    def one(statistic: GradientStatistic, mean: Array, gradient: Array) -> GradientStatistic:
        # Root mean square distance to all the cameras of the batch at once.
        distance = jnp.sqrt(jnp.sum((mean - center[None]) ** 2, axis=-1) + spread)
        return accumulate(statistic, gradient, distance)

    p, transient = state.parameters, None
    if state.transient_statistic is not None and p.transient is not None:
        transient = one(state.transient_statistic, p.transient.mean, gradient.transient.mean)  # type: ignore[union-attr]
    return (
        one(state.static_statistic, p.static.mean, gradient.static.mean),
        one(state.moving_statistic, p.moving.mean, gradient.moving.mean),
        transient,
    )


class ChangedRows(NamedTuple):
    """Gaussians after density control, and which rows are new: Adam's moments of these start at
    zero."""

    gaussians: Unconstrained | UnconstrainedTransients
    fresh: Bool[np.ndarray, " rows"]


def with_gaussians(state: State, changed: dict[str, ChangedRows]) -> State:
    """The state with changed Gaussians. Adam's moments follow their rows; the gradient statistics
    start again.

    Args:
        state: the state before density control.
        changed: the Gaussians of each kind (static, moving, transient) that changed.
    """

    def replaced(parameters: Parameters, values: dict[str, Any]) -> Parameters:
        return eqx.tree_at(
            lambda p: [getattr(p, n) for n in values], parameters, [*values.values()]
        )

    def renewed(moment: Parameters) -> Parameters:
        rows = {
            kind: jax.tree.map(partial(renewed_moment, fresh=part.fresh), getattr(moment, kind))
            for kind, part in changed.items()
        }
        return replaced(moment, rows)

    parameters = replaced(state.parameters, {n: part.gaussians for n, part in changed.items()})
    mu, nu = (renewed(x) for x in (state.adam.mu, state.adam.nu))  # type: ignore[arg-type]
    adam = state.adam._replace(mu=mu, nu=nu)
    return eqx.tree_at(lambda s: (s.adam, s.step), begin_state(parameters), (adam, state.step))


@jax.jit
def renewed_moment(moment: Array, fresh: Bool[np.ndarray | Array, " rows"]) -> Array:
    """A moment of Adam after rows have changed: kept where a Gaussian stayed, 0 where one is new.

    Args:
        moment: the moment of one array, with rows before the change.
        fresh: which rows hold a new Gaussian; rows that were added are at the end.
    """
    moment = jnp.pad(moment, ((0, len(fresh) - moment.shape[0]),) + ((0, 0),) * (moment.ndim - 1))
    mask = jnp.asarray(fresh).reshape(-1, *(1,) * (moment.ndim - 1))
    return jnp.where(mask, 0, moment)
