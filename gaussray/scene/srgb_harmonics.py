"""Converts harmonics of colours from sRGB values to linear light."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.color import srgb_decode
from gaussray.geometry import product
from gaussray.scene.harmonics import harmonic_basis


# Rings of directions: with twice as many on each, polynomials of degree 11 are summed exactly.
RINGS = 6
# Gaussians whose colours are decoded at a time: bounds the memory, and keeps it near.
BLOCK = 1 << 13


def sphere_directions() -> tuple[
    Float[np.ndarray, "directions 3"], Float[np.ndarray, " directions"]
]:
    """Directions all around and their shares of the sphere: Gauss-Legendre in z, even rings."""
    z, share = np.polynomial.legendre.leggauss(RINGS)
    angle = np.pi * np.arange(2 * RINGS) / RINGS
    across = np.sqrt(1 - z * z)[:, None]
    x, y = across * np.cos(angle), across * np.sin(angle)
    way = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1).reshape(-1, 3)
    return way, np.repeat(share / 2, 2 * RINGS) / (2 * RINGS)


def harmonic_projection(
    coefficients: int,
) -> tuple[Float[Array, "directions coefficients"], Float[Array, "directions coefficients"]]:
    """The harmonics Y in all directions, and 4 pi Y times the directions' shares: sums with these
    are a function's coefficients."""
    way, weight = sphere_directions()
    values = jnp.stack(harmonic_basis(jnp.asarray(way.T), coefficients), axis=-1)
    return values, jnp.asarray(4 * np.pi * weight)[:, None] * values


def decode_harmonics(
    harmonics: Float[Array, "gaussians coefficients 3"],
) -> Float[Array, "gaussians coefficients 3"]:
    """Convert harmonics of sRGB values to harmonics of linear light.

    The values max(0, 1/2 + sum c_i Y_i) are decoded in directions all around and projected onto the
    same harmonics, which is exact for a colour that does not depend on the direction.
    """
    values, weights = (x.astype(harmonics.dtype) for x in harmonic_projection(harmonics.shape[1]))

    def one(row: Float[Array, "coefficients 3"]) -> Float[Array, "coefficients 3"]:
        codes = jnp.maximum(product("dc,ck->dk", values, row) + 0.5, 0)
        return product("dc,dk->ck", weights, srgb_decode(codes) - 0.5)

    return jax.lax.map(one, harmonics, batch_size=BLOCK)
