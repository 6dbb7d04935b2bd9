"""The Bayer colour filter array (Bayer 1976) and bilinear demosaicing."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


# The filters of rows 0 and 1, left to right.
PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
# Weights of the eight neighbours and the middle.
_NEAR = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]])


def filter_mask(pattern: str, height: int, width: int) -> Bool[np.ndarray, "h w 3"]:
    """The colour channel of each pixel's filter, as a mask of red, green and blue.

    Args:
        pattern: one of `PATTERNS`.
        height: height of the picture in pixels.
        width: width of the picture in pixels.
    """
    row, column = np.mgrid[:height, :width]
    channel = np.array(["RGB".index(letter) for letter in pattern])
    return np.arange(3) == channel[2 * (row % 2) + column % 2][..., None]


def mosaic(light: Float[Array, "h w 3"], pattern: str) -> Float[Array, "h w 3"]:
    """Light behind the colour filters: each pixel keeps one channel, the others are 0.

    The sum of the channels is the raw picture.

    Args:
        light: linear red, green and blue.
        pattern: one of `PATTERNS`.
    """
    return jnp.where(filter_mask(pattern, *light.shape[:2]), light, 0)


def demosaic(raw: Float[Array, "h w 3"], pattern: str) -> Float[Array, "h w 3"]:
    """Bilinear demosaicing.

    A missing channel is the mean of the nearest pixels that have it: the two or four at distance 1,
    or else the four at distance sqrt 2 (fewer at the border).

    Args:
        raw: the mosaic, each pixel with its own channel and 0 elsewhere.
        pattern: one of `PATTERNS`.
    """
    filtered = filter_mask(pattern, *raw.shape[:2])
    total = _blurred(jnp, raw)
    weight = _blurred(np, filtered.astype(float))
    return jnp.where(filtered, raw, total / np.maximum(weight, 1).astype(raw.dtype))


def _blurred(xp, picture):
    """Sums over the 3 x 3 neighbourhoods, with their weights; nothing lies outside."""
    height, width = picture.shape[:2]
    padded = xp.pad(picture, ((1, 1), (1, 1), (0, 0)))
    shifts = ((i, j) for i in range(3) for j in range(3))
    return sum(int(_NEAR[i, j]) * padded[i : i + height, j : j + width] for i, j in shifts)
