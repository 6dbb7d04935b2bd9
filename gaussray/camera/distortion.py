"""Lens distortion of an ideal pinhole, after OpenCV."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaussray.camera.roots import keeps_orientation, plane_root


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


def _radial(
    coefficients: Float[Array, " coefficients"], square: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Numerator and denominator of the factor of the radius, whose square is given."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients[:8]
    above = 1 + square * (k1 + square * (k2 + square * k3))
    below = 1 + square * (k4 + square * (k5 + square * k6))
    return above, below


def _radius_grows(
    coefficients: Float[Array, " coefficients"], xy: Float[Array, "2"]
) -> Bool[Array, ""]:
    """Whether the distorted radius grows with the ideal one all the way from the centre to a point.

    Beyond a fold it may grow again, or pass the centre to the other side, where it falls: both keep
    the orientation.
    """
    share = jnp.arange(1, _PLACES + 1, dtype=xy.dtype) / _PLACES
    square = jnp.dot(xy, xy) * share**2
    one = jnp.ones_like(square)
    (above, below), (d_above, d_below) = jax.jvp(
        lambda u: _radial(coefficients, u), (square,), (one,)
    )
    # The derivative of r above / below, times below^2.
    rises = above * below + 2 * square * (d_above * below - above * d_below) > 0
    return jnp.all(rises & (below > 0))


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
    return keeps_orientation(_bent, xy, coefficients) & _radius_grows(coefficients, xy)


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
        _bent, target, coefficients, start, steps=_NEWTON_STEPS, residual=_RESIDUAL
    )
    return xy, found & _radius_grows(*jax.lax.stop_gradient((coefficients, xy)))


def _bent(xy: Float[Array, "2"], coefficients: Float[Array, " coefficients"]) -> Array:
    return distort(coefficients, xy)
