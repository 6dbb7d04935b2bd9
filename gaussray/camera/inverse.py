"""The root of an increasing function, differentiable in everything it depends on."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import jaxopt
from jaxtyping import Array, Float


# Halvings of the bracket before Newton, which then at least squares the error at every step:
# 2^-17, 1e-10, 1e-16 where the curvature over the whole bracket is of the order of the slope.
HALVINGS, POLISH = 16, 2


def increasing_root(
    function: Callable[[Array, Any], Array],
    value: Float[Array, ""],
    parameters: Any,
    upper: Float[Array, ""],
) -> Float[Array, ""]:
    """The x in [0, upper] where function(x, parameters) = value.

    The caller makes sure that there is one: function(0) <= value <= function(upper). Bisection
    finds it without gradient; the last Newton step carries the exact first derivatives with respect
    to `value` and `parameters` (implicit function theorem), forward and reverse.
    """

    def residual(part, value, parameters, upper):
        # Below 0 the function goes on as a straight line, so that a root at exactly 0 (the optical
        # axis) is inside the bracket: jaxopt returns the upper end for a root on the lower one.
        inside = function(jnp.maximum(part, 0) * upper, parameters)
        return inside + jnp.minimum(part, 0) - value

    solver = jaxopt.Bisection(
        residual, lower=-0.5, upper=1.0, maxiter=HALVINGS, tol=0.0, check_bracket=False
    )
    fixed = jax.lax.stop_gradient((value, parameters, upper))
    start = solver.run(None, *fixed).params.astype(value.dtype) * fixed[2]

    def newton(x, value, parameters):
        y, slope = jax.value_and_grad(function)(x, parameters)
        # Where the function is flat (slope 0, e.g. a polynomial without linear term at 0) the
        # bisection's answer stays.
        rises = slope > 0
        return x - jnp.where(rises, y - value, 0) / jnp.where(rises, slope, 1)

    x = jax.lax.stop_gradient(start)
    for _ in range(POLISH):
        x = newton(x, fixed[0], fixed[1])
    return newton(jax.lax.stop_gradient(x), value, parameters)
