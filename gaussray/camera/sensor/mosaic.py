"""The Bayer colour filter array (Bayer 1976) and bilinear demosaicing."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


# The filters of rows 0 and 1, left to right.
PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
# Weights of the eight neighbours and the middle.
_NEAR = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]])


def filters(pattern: str, height: int, width: int) -> Bool[np.ndarray, "h w 3"]:
    """Which of red, green and blue each photosite sees."""
    row, column = np.mgrid[:height, :width]
    channel = np.array(["RGB".index(letter) for letter in pattern])
    return np.arange(3) == channel[2 * (row % 2) + column % 2][..., None]


def mosaic(light: Float[Array, "h w 3"], pattern: str) -> Float[Array, "h w 3"]:
    """Light behind the filters: each pixel has one channel, the others are 0, so that the sum of
    the channels is the raw picture."""
    return jnp.where(filters(pattern, *light.shape[:2]), light, 0)


def demosaic(raw: Float[Array, "h w 3"], pattern: str) -> Float[Array, "h w 3"]:
    """Bilinear colours: what a pixel's filter kept out is the mean of the nearest photosites that
    saw it, the two or four at distance 1 or else the four at sqrt 2 (fewer at the border)."""
    seen = filters(pattern, *raw.shape[:2])
    total = _blurred(jnp, raw)
    weight = _blurred(np, seen.astype(float))
    return jnp.where(seen, raw, total / np.maximum(weight, 1).astype(raw.dtype))


def _blurred(xp, picture):
    """Sums over the 3 x 3 neighbourhoods, with their weights; nothing lies outside."""
    height, width = picture.shape[:2]
    padded = xp.pad(picture, ((1, 1), (1, 1), (0, 0)))
    shifts = ((i, j) for i in range(3) for j in range(3))
    return sum(int(_NEAR[i, j]) * padded[i : i + height, j : j + width] for i, j in shifts)
