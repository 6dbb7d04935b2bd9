"""Roots of functions, on a line or in the plane, differentiable in everything they depend on."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import jaxopt
from jaxtyping import Array, Bool, Float


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


def plane_root(
    function: Callable[[Array, Any], Array],
    value: Float[Array, "2"],
    parameters: Any,
    start: Float[Array, "2"],
    *,
    steps: int,
    residual: float,
) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
    """The x in the plane where function(x, parameters) = value, and whether one was found: with
    less than that residual, where the function keeps orientation.

    Newton from `start` without gradient, then one step that carries the exact first derivatives
    with respect to `value` and `parameters`. Where none is found x is `start`.
    """

    def newton(x, value, parameters):
        error = function(x, parameters) - value
        a, b, c, d = _jacobian(function, x, parameters)
        determinant = a * d - b * c
        step = jnp.stack([d * error[0] - b * error[1], a * error[1] - c * error[0]])
        return x - step / jnp.where(determinant == 0, 1, determinant)

    fixed = jax.lax.stop_gradient((value, parameters))
    x = jax.lax.stop_gradient(start)
    for _ in range(steps):
        x = newton(x, *fixed)
    error = jnp.max(jnp.abs(function(x, fixed[1]) - fixed[0]))
    found = (error < residual) & keeps_orientation(function, x, fixed[1])
    # Where Newton failed it may have run to infinity; the start keeps the gradients finite.
    x = jnp.where(found, x, start)
    return newton(jax.lax.stop_gradient(x), value, parameters), found


def keeps_orientation(
    function: Callable[[Array, Any], Array], x: Float[Array, "2"], parameters: Any
) -> Bool[Array, ""]:
    """Whether a map of the plane turns neither over nor flat at a point."""
    a, b, c, d = _jacobian(function, x, parameters)
    return a * d - b * c > 0


def _jacobian(function, x, parameters):
    (a, b), (c, d) = jax.jacfwd(function)(x, parameters)
    return a, b, c, d
