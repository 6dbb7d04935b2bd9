"""What a fit carries from step to step, and what happens to it between blocks of steps."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from gaussray.reconstruct.optimize.density import (
    DensityOptions,
    Pull,
    no_pull,
    pulled,
    refine,
    refreshed,
)
from gaussray.reconstruct.optimize.optimizer import ADAM, Parameters


class State(eqx.Module):
    """Parameters, Adam's moments, the statistic of density control and the steps of the stage."""

    parameters: Parameters
    adam: optax.ScaleByAdamState
    static_pull: Pull
    moving_pull: Pull
    step: Int[Array, ""]


def begin_state(parameters: Parameters) -> State:
    """A stage's start: moments and statistic zero."""
    return State(
        parameters,
        ADAM.init(parameters),  # type: ignore[arg-type]
        no_pull(parameters.static.logit_opacity.shape[0]),
        no_pull(parameters.moving.logit_opacity.shape[0]),
        jnp.zeros((), jnp.int32),
    )


def watch(state: State, gradient: Parameters, eye: Float[Array, "rays 3"]) -> tuple[Pull, Pull]:
    """The density statistic after one more step, for rays from `eye`."""
    center = jnp.mean(eye, axis=0)
    spread = jnp.mean(jnp.sum((eye - center[None]) ** 2, axis=-1))

    def one(pull: Pull, mean: Array, gradient: Array) -> Pull:
        # Root mean square distance to all the cameras of the batch at once.
        distance = jnp.sqrt(jnp.sum((mean - center[None]) ** 2, axis=-1) + spread)
        return pulled(pull, gradient, distance)

    parameters = state.parameters
    return (
        one(state.static_pull, parameters.static.mean, gradient.static.mean),
        one(state.moving_pull, parameters.moving.mean, gradient.moving.mean),
    )


def refine_state(
    state: State, *, options: DensityOptions, extent: float, limit: tuple[int, int], seed: int
) -> State:
    """Density control on both sets; moments move with their rows."""
    parts, fresh = {}, {}
    for i, name in enumerate(("static", "moving")):
        free, pull = getattr(state.parameters, name), getattr(state, f"{name}_pull")
        parts[name], fresh[name] = refine(
            free, pull, options=options, extent=extent, limit=limit[i], seed=2 * seed + i
        )
    kept = state.parameters
    parameters = Parameters(parts["static"], parts["moving"], kept.deformation, kept.corrections)

    def move(moment: Parameters) -> Parameters:
        rows = {
            name: jax.tree.map(lambda x, f=fresh[name]: refreshed(x, f), getattr(moment, name))
            for name in fresh
        }
        return Parameters(rows["static"], rows["moving"], moment.deformation, moment.corrections)

    mu, nu = (move(x) for x in (state.adam.mu, state.adam.nu))  # type: ignore[arg-type]
    adam = state.adam._replace(mu=mu, nu=nu)
    renewed = begin_state(parameters)
    return eqx.tree_at(lambda s: (s.adam, s.step), renewed, (adam, state.step))


def take(tree, rows: np.ndarray):
    """The same tree with only these rows."""
    return jax.tree.map(lambda x: x[rows], tree)
