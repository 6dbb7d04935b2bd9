"""Tone curves: from linear light to the values that a picture file stores."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.color import srgb_encode


TONE_CURVES = ("srgb", "linear", "filmic", "table")


def apply_tone_curve(
    light: Float[Array, "*n"], curve: str, table: Float[Array, " knots"]
) -> Float[Array, "*n"]:
    """Apply a tone curve.

    `srgb` is the standard curve (IEC 61966-2-1). `linear` stores the light itself. `filmic` rolls
    highlights off: the rational fit of Narkowicz (2015) to the look of ACES,
    x (2.51 x + 0.03) / (x (2.43 x + 0.59) + 0.14), then encoded as sRGB (for the exposure of ACES,
    multiply the light by 0.6). `table` is the response of a camera.

    Args:
        light: linear light.
        curve: one of `TONE_CURVES`.
        table: stored values at even steps of light from 0 to 1, for `table`; linear in between.

    Returns:
        Stored values, in [0, 1] for light in [0, 1].
    """
    if curve == "linear":
        return light
    if curve == "table":
        return jnp.interp(light, jnp.linspace(0, 1, table.shape[0], dtype=light.dtype), table)
    if curve == "filmic":
        x = jnp.maximum(light, 0)
        light = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    return srgb_encode(light)
