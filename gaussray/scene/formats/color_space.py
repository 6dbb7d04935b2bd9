"""Colours of Gaussians as sRGB values or as linear light, and conversion of their harmonics."""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.color import srgb_decode, srgb_encode
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.srgb_harmonics import harmonic_projection, sphere_directions


# Colours of a model: sRGB values, as in models fitted to 8-bit pictures, or linear light.
COLORS = ("srgb", "linear")
# Gaussians whose colours are converted at a time: bounds the memory.
CONVERSION_BLOCK = 1 << 16


def check_color(color: str) -> None:
    """Raise a ValueError unless the colour space is known."""
    if color not in COLORS:
        raise ValueError(f"color must be one of {', '.join(COLORS)}, got {color!r}.")


def convert_harmonics(
    harmonics: Float[Array, "gaussians coefficients 3"], *, encode: bool
) -> tuple[Float[Array, "gaussians coefficients 3"], float]:
    """Convert the harmonics of colours between linear light and sRGB values.

    The colour f = max(0, 1/2 + sum c_i Y_i) is passed through the sRGB curve in directions all
    around, and projected onto the same harmonics: c'_i is the mean over the sphere of
    4 pi Y_i (f - 1/2). This is exact for a colour that does not depend on the direction.

    Args:
        harmonics: coefficients of the colours.
        encode: True: linear light to sRGB values; False: sRGB values to linear light.

    Returns:
        The new coefficients, and the error of the projection: root mean square over directions,
        channels and Gaussians, in sRGB values 0 to 1.
    """
    count, coefficients, _ = harmonics.shape
    _, weight = sphere_directions()
    values, sums = (np.asarray(x, np.float32) for x in harmonic_projection(coefficients))
    result, square = np.empty(harmonics.shape, np.float32), 0.0
    for begin in range(0, count, CONVERSION_BLOCK):
        part = np.asarray(harmonics[begin : begin + CONVERSION_BLOCK], np.float32)
        before = _colors_in_directions(values, part)
        target = srgb_encode(before) if encode else srgb_decode(before)
        fitted = np.einsum("dc,dnk->nck", sums, target - 0.5, optimize=True)
        result[begin : begin + CONVERSION_BLOCK] = fitted
        after = _colors_in_directions(values, fitted)
        off = after - target if encode else srgb_encode(after) - before
        square += float(np.einsum("d,dnk->", weight, np.square(off, dtype=np.float64)))
    return jnp.asarray(result, harmonics.dtype), math.sqrt(square / max(3 * count, 1))


def _colors_in_directions(
    values: Float[np.ndarray, "directions coefficients"],
    harmonics: Float[np.ndarray, "gaussians coefficients 3"],
) -> Float[np.ndarray, "directions gaussians 3"]:
    """The colours in all directions."""
    return np.maximum(np.einsum("dc,nck->dnk", values, harmonics, optimize=True) + 0.5, 0)


def with_harmonics(
    gaussians: Gaussians, harmonics: Float[Array, "gaussians coefficients 3"]
) -> Gaussians:
    """The Gaussians with other harmonics, and without tints.

    Args:
        gaussians: the Gaussians.
        harmonics: coefficients of their colours.
    """
    return Gaussians(gaussians.mean, gaussians.quat, gaussians.scale, gaussians.opacity, harmonics)


def color_error_text(error: float) -> str:
    """The words on the error of converted harmonics (`convert_harmonics`)."""
    return f"off by {255 * error:.2g} of 255 (root mean square) for the degree of the harmonics"
