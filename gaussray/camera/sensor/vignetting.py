"""Vignetting: natural falloff and a radial polynomial."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.film import Film, pixel_grid
from gaussray.camera.lens import AbstractLens
from gaussray.camera.principal_point import axis_of
from gaussray.geometry import safe_norm


def transmission(
    lens: AbstractLens,
    film: Film,
    falloff: Float[Array, ""],
    polynomial: Float[Array, "3"],
) -> Float[Array, "h w"]:
    """Vignetting: the share of the light that reaches each pixel.

    It is cos(theta)^falloff (1 + a1 rho^2 + a2 rho^4 + a3 rho^6).

    theta is the angle of the pixel's chief ray from the axis: falloff 4 is the natural law of a
    flat sensor behind a small pupil, 0 none (a fisheye lens keeps its edges lighter), and from 90
    degrees on there is no light. rho is the distance from the axis in half diagonals of the
    picture, 1 in the corners, with the even polynomial of Goldman and Chen (2005), cut at 0.

    Args:
        lens: the lens.
        film: size of the picture.
        falloff: exponent of the natural vignetting.
        polynomial: a1, a2, a3.
    """
    pixel = pixel_grid(film).astype(polynomial.dtype) + 0.5
    from_axis = pixel - axis_of(lens, pixel.dtype)[None, None]
    half_diagonal = np.hypot(film.width, film.height) / 2
    square = (safe_norm(from_axis) / half_diagonal) ** 2
    cos = jax.vmap(jax.vmap(lens.direction))(pixel)[..., 2]
    ahead = cos > 0
    natural = jnp.where(ahead, jnp.where(ahead, cos, 1) ** falloff, falloff == 0)
    a1, a2, a3 = polynomial
    return natural * jnp.maximum(1 + square * (a1 + square * (a2 + square * a3)), 0)


def least_transmission(polynomial: tuple[float, ...]) -> float:
    """The smallest value of the vignetting polynomial between axis and corner."""
    square = np.linspace(0, 1, 1025)
    return float(np.polynomial.polynomial.polyval(square, [1, *polynomial]).min())
