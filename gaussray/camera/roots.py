"""Differentiable roots of functions of one or two variables."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


# Bisections of the bracket before Newton's method, which then squares the error at every step:
# 2^-17, 1e-10, 1e-16 where the curvature over the whole bracket is of the order of the slope.
HALVINGS, POLISH = 16, 2

# The entries (du/dx, du/dy, dv/dx, dv/dy) of the Jacobian of a map of the plane at a point.
Jacobian = tuple[Array, Array, Array, Array]


def increasing_root(
    function: Callable[[Array, Any], Array],
    value: Float[Array, ""],
    parameters: Any,
    upper: Float[Array, ""],
) -> Float[Array, ""]:
    """The x in [0, upper] where function(x, parameters) = value.

    Bisection finds it without gradient. The last Newton step has the exact first derivatives with
    respect to `value` and `parameters` (implicit function theorem), forward and reverse.

    Args:
        function: increases in its first argument.
        value: the value to reach; function(0) <= value <= function(upper).
        parameters: second argument of the function, any pytree.
        upper: upper end of the bracket.
    """

    # Imported here: it takes a third of a second, and few lenses need it.
    import jaxopt

    def residual(part, value, parameters, upper):
        # Below 0 the function is continued as a straight line, so that a root at 0 (the optical
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
    jacobian: Callable[[Array, Any], Jacobian] | None = None,
) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
    """The x in the plane where function(x, parameters) = value, by Newton's method.

    The last step has the exact first derivatives with respect to `value` and `parameters`. The
    others are a loop: a program with a copy of each takes XLA twice as long to compile.

    Args:
        function: maps the plane to itself.
        value: the value to reach.
        parameters: second argument of the function, any pytree.
        start: where Newton's method starts.
        steps: number of steps without gradient.
        residual: largest error, per coordinate, of a root.
        jacobian: of the function; None differentiates it.

    Returns:
        The root, or `start` if none was found; and whether it was found: the error is below
        `residual`, and the function keeps orientation there.
    """

    slopes = jacobian or jacobian_of(function)

    def newton(x, value, parameters):
        error = function(x, parameters) - value
        a, b, c, d = slopes(x, parameters)
        determinant = a * d - b * c
        step = jnp.stack([d * error[0] - b * error[1], a * error[1] - c * error[0]])
        return x - step / jnp.where(determinant == 0, 1, determinant)

    fixed = jax.lax.stop_gradient((value, parameters))
    x = jax.lax.stop_gradient(start)
    x = x.astype(jax.eval_shape(newton, x, *fixed).dtype)
    x = jax.lax.fori_loop(0, steps, lambda _, x: newton(x, *fixed), x)
    error = jnp.max(jnp.abs(function(x, fixed[1]) - fixed[0]))
    is_root = (error < residual) & keeps_orientation(slopes(x, fixed[1]))
    # Where Newton failed it may have run to infinity; the start keeps the gradients finite.
    x = jnp.where(is_root, x, start)
    return newton(jax.lax.stop_gradient(x), value, parameters), is_root


def keeps_orientation(jacobian: Jacobian) -> Bool[Array, ""]:
    """Whether the determinant of a map's Jacobian is positive."""
    a, b, c, d = jacobian
    return a * d - b * c > 0


def jacobian_of(function: Callable[[Array, Any], Array]) -> Callable[[Array, Any], Jacobian]:
    """The Jacobian of a map of the plane, by forward differentiation.

    Args:
        function: maps the plane to itself; its second argument is any pytree.
    """

    def slopes(x: Array, parameters: Any) -> Jacobian:
        (a, b), (c, d) = jax.jacfwd(function)(x, parameters)
        return a, b, c, d

    return slopes
