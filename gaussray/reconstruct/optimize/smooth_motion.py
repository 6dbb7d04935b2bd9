"""Motion that is learnt at all times at once, from pictures that each show one of them."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.geometry import product
from gaussray.reconstruct.optimize.optimizer import Parameters


def time_kernel(instants: int) -> Float[Array, "instants instants"]:
    """How far the gradient of a pose at one instant counts at the others: a sum of Gaussian
    functions of the number of instants between them, of standard deviations 0, 1, 2, 4, ... up to
    half of all, each divided by the root of its own (1 for the first two).

    A step down a gradient times this matrix moves all times at first, then those near each picture
    (Sobolev gradient; as if paths were sums of splines of all these widths, each learnt).

    Args:
        instants: the number of instants.
    """
    place = jnp.arange(instants, dtype=jnp.float32)
    square = (place[:, None] - place[None]) ** 2
    kernel, width = jnp.eye(instants), 1.0
    while width < instants / 2:
        kernel = kernel + jnp.exp(-0.5 * square / width**2) / width**0.5
        width *= 2
    return kernel


def spread_over_time(gradient: Parameters) -> Parameters:
    """The gradient with that of the control points' poses spread over time (`time_kernel`).

    A picture tells where things are at its own time alone, and from one side. Poses of the times
    before and after are therefore likely to be wrong in the same way.

    Args:
        gradient: gradient of the loss; without control points it is returned as it is.
    """
    deformation = gradient.deformation
    if deformation is None or deformation.control is None:
        return gradient
    control = deformation.control
    kernel = time_kernel(control.path.shape[1]).astype(control.path.dtype)
    spread = tuple(product("ts,nsc->ntc", kernel, x) for x in (control.path, control.turn))
    return eqx.tree_at(
        lambda g: (g.deformation.control.path, g.deformation.control.turn), gradient, spread
    )
