"""Lens distortion of an ideal pinhole, after OpenCV."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


# Newton steps from the distorted point; each squares the error, which starts below 1.
STEPS = 6
# Largest residual, in focal lengths, of a point that counts as undistorted: far below a pixel, far
# above rounding in single precision.
RESIDUAL = 1e-4


def distort(coefficients: Float[Array, "8"], xy: Float[Array, "2"]) -> Float[Array, "2"]:
    """Image point, in focal lengths, of the ideal image point `xy`.

    With coefficients (k1, k2, p1, p2, k3, k4, k5, k6) and r^2 = x^2 + y^2:
    x (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2),
    and likewise y with p1 and p2 exchanged.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = xy
    square = x * x + y * y
    above = 1 + square * (k1 + square * (k2 + square * k3))
    below = 1 + square * (k4 + square * (k5 + square * k6))
    radial = above / below
    return jnp.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + 2 * p2 * x * y + p1 * (square + 2 * y * y),
        ]
    )


def unfolded(coefficients: Float[Array, "8"], xy: Float[Array, "2"]) -> Bool[Array, ""]:
    """Whether the distortion keeps the picture's orientation at the ideal point `xy`.

    Strong coefficients fold the picture back onto itself far from the centre; no real lens does.
    """
    (a, b), (c, d) = jax.jacfwd(distort, argnums=1)(coefficients, xy)
    return a * d - b * c > 0


def undistort(
    coefficients: Float[Array, "8"], target: Float[Array, "2"]
) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
    """Ideal image point that `distort` takes to `target`, and whether there is one.

    Newton without gradient, then one step that carries the exact first derivatives.
    """

    def newton(xy, coefficients, target):
        error = distort(coefficients, xy) - target
        (a, b), (c, d) = jax.jacfwd(distort, argnums=1)(coefficients, xy)
        determinant = a * d - b * c
        step = jnp.stack([d * error[0] - b * error[1], a * error[1] - c * error[0]])
        return xy - step / jnp.where(determinant == 0, 1, determinant)

    fixed = jax.lax.stop_gradient((coefficients, target))
    xy = fixed[1]
    for _ in range(STEPS):
        xy = newton(xy, *fixed)
    residual = jnp.max(jnp.abs(distort(fixed[0], xy) - fixed[1]))
    found = (residual < RESIDUAL) & unfolded(fixed[0], xy)
    # Where Newton failed it may have run to infinity; the target keeps the gradients finite.
    xy = jnp.where(found, xy, fixed[1])
    return newton(jax.lax.stop_gradient(xy), coefficients, target), found
