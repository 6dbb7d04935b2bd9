"""Lens distortion of an ideal pinhole, after OpenCV."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaussray.camera.roots import Jacobian, keeps_orientation, plane_root


# The coefficients in OpenCV's order: radial and tangential, the thin prism's, the sensor's tilt.
COEFFICIENTS = (
    *("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    *("s1", "s2", "s3", "s4"),
    *("tau_x", "tau_y"),
)
# How many of them a lens may have.
COUNTS = (8, 12, 14)
# Newton steps from the distorted point; each squares the error, which starts below 1.
_NEWTON_STEPS = 6
# Largest residual, in focal lengths, of a point that counts as undistorted: far below a pixel, far
# above rounding in single precision.
_RESIDUAL = 1e-4
# Places between the centre and a point at which the radius must grow.
_PLACES = 8


def distort(coefficients: Float[Array, " coefficients"], xy: Float[Array, "2"]) -> Array:
    """Distort an ideal image point with OpenCV's model.

    With r^2 = x^2 + y^2, the distorted x is
    x (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    + s1 r^2 + s2 r^4, and likewise y with p1 and p2 exchanged, s3 and s4. A sensor that is tilted
    by tau_x about x, then tau_y about y (radians) then sees that in perspective.

    Args:
        coefficients: the first 8, 12 or all 14 of (k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4,
            tau_x, tau_y).
        xy: point in focal lengths from the principal point.
    """
    p1, p2 = coefficients[2:4]
    x, y = xy
    square = x * x + y * y
    above, below = _radial(coefficients, square)
    radial = above / below
    bent = jnp.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + 2 * p2 * x * y + p1 * (square + 2 * y * y),
        ]
    )
    if coefficients.shape[0] > 8:
        s1, s2, s3, s4 = coefficients[8:12]
        bent += square * jnp.stack([s1 + s2 * square, s3 + s4 * square])
    if coefficients.shape[0] > 12:
        bent = _tilted(coefficients[12:], bent)
    return bent


def distort_jacobian(
    coefficients: Float[Array, " coefficients"], xy: Float[Array, "2"]
) -> Jacobian:
    """The Jacobian of `distort` in the image point.

    Written out: differentiated by JAX, it makes a lens twice as large a program.

    Args:
        coefficients: 8, 12 or 14 coefficients in OpenCV's order.
        xy: point in focal lengths from the principal point.
    """
    p1, p2 = coefficients[2:4]
    x, y = xy
    square = x * x + y * y
    radial, slope = _radial_slope(coefficients, square)
    # d radial / dx = 2 x slope, d square / dx = 2 x.
    across = 2 * (x * y * slope + p1 * x + p2 * y)
    jacobian = (
        radial + 2 * (x * x * slope + p1 * y + 3 * p2 * x),
        across,
        across,
        radial + 2 * (y * y * slope + p2 * x + 3 * p1 * y),
    )
    if coefficients.shape[0] > 8:
        s1, s2, s3, s4 = coefficients[8:12]
        u, v = 2 * (s1 + 2 * s2 * square), 2 * (s3 + 2 * s4 * square)
        a, b, c, d = jacobian
        jacobian = a + u * x, b + u * y, c + v * x, d + v * y
    if coefficients.shape[0] > 12:
        a, b, c, d = jacobian
        bent = distort(coefficients[:12], xy)
        (e, f), (g, h) = jax.jacfwd(_tilted, argnums=1)(coefficients[12:], bent)
        jacobian = e * a + f * c, e * b + f * d, g * a + h * c, g * b + h * d
    return jacobian


def _radial(
    coefficients: Float[Array, " coefficients"], square: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Numerator and denominator of the factor of the radius, whose square is given."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients[:8]
    above = 1 + square * (k1 + square * (k2 + square * k3))
    below = 1 + square * (k4 + square * (k5 + square * k6))
    return above, below


def _radial_slope(
    coefficients: Float[Array, " coefficients"], square: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """The factor of the radius and its derivative in the radius' square."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients[:8]
    above, below = _radial(coefficients, square)
    radial = above / below
    d_above = k1 + square * (2 * k2 + 3 * square * k3)
    d_below = k4 + square * (2 * k5 + 3 * square * k6)
    return radial, (d_above - radial * d_below) / below


def _radius_grows(
    coefficients: Float[Array, " coefficients"], xy: Float[Array, "2"]
) -> Bool[Array, ""]:
    """Whether the distorted radius grows with the ideal one all the way from the centre to a point.

    Beyond a fold it may grow again, or pass the centre to the other side, where it falls: both keep
    the orientation.
    """
    share = jnp.arange(1, _PLACES + 1, dtype=xy.dtype) / _PLACES
    square = jnp.dot(xy, xy) * share**2
    _, below = _radial(coefficients, square)
    radial, slope = _radial_slope(coefficients, square)
    # The derivative of the radius times the factor.
    return jnp.all((radial + 2 * square * slope > 0) & (below > 0))


def _tilted(tau: Float[Array, "2"], xy: Float[Array, "2"]) -> Float[Array, "2"]:
    """Where the ray through `xy` meets the tilted sensor, whose axial point stays in place."""
    (cx, cy), (sx, sy) = jnp.cos(tau), jnp.sin(tau)
    x, y = xy
    depth = sy * x - cy * sx * y + cy * cx
    across = jnp.stack([cy * x + sy * sx * y - sy * cx, cx * y + sx])
    return cy * cx * across / depth + jnp.stack([sy * cx, -sx])


def keeps_picture_orientation(
    coefficients: Float[Array, " coefficients"], xy: Float[Array, "2"]
) -> Bool[Array, ""]:
    """Whether the distortion keeps the picture's orientation from the centre to an ideal image
    point.

    Strong coefficients fold the picture back onto itself far from the centre; no real lens does.

    Args:
        coefficients: 8, 12 or 14 coefficients in OpenCV's order.
        xy: the ideal image point, in focal lengths.
    """
    return keeps_orientation(distort_jacobian(coefficients, xy)) & _radius_grows(coefficients, xy)


# Traced once for all programs that it becomes part of.
@functools.partial(jax.jit, inline=True)
def undistort(
    coefficients: Float[Array, " coefficients"], target: Float[Array, "2"]
) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
    """Undistort an image point: the inverse of `distort`, by Newton's method.

    Args:
        coefficients: 8, 12 or 14 coefficients in OpenCV's order.
        target: the distorted image point, in focal lengths.

    Returns:
        The ideal image point, and whether there is one before the picture folds.
    """
    start = jax.lax.stop_gradient(target)
    xy, found = plane_root(
        lambda xy, k: distort(k, xy),
        target,
        coefficients,
        start,
        steps=_NEWTON_STEPS,
        residual=_RESIDUAL,
        jacobian=lambda xy, k: distort_jacobian(k, xy),
    )
    return xy, found & _radius_grows(*jax.lax.stop_gradient((coefficients, xy)))
