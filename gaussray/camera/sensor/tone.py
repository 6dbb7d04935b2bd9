"""Tone curves: from linear light to the values that a picture file stores."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.color import srgb_encode


TONE_CURVES = ("srgb", "linear", "filmic", "table")


def toned(
    light: Float[Array, "*n"], curve: str, table: Float[Array, " knots"]
) -> Float[Array, "*n"]:
    """Stored values in [0, 1], up to where the curve itself goes beyond.

    `srgb` is the standard curve (IEC 61966-2-1), `linear` stores the light itself. Of the others
    neither is a standard: `filmic` rolls highlights off, the rational fit of Narkowicz (2015) to
    the look of ACES, x (2.51 x + 0.03) / (x (2.43 x + 0.59) + 0.14), then encoded as sRGB (for
    ACES' own exposure let 0.6 of the light in); `table` is a camera's own response, stored values
    at even steps of light from 0 to 1, straight between.
    """
    if curve == "linear":
        return light
    if curve == "table":
        return jnp.interp(light, jnp.linspace(0, 1, table.shape[0], dtype=light.dtype), table)
    if curve == "filmic":
        x = jnp.maximum(light, 0)
        light = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    return srgb_encode(light)
