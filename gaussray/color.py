"""The sRGB curve between linear light and stored 8-bit values, and PSNR of encoded values."""

import math
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np


# An error that `least` of `psnr_from_mse` may be set to, so that PSNR ends at 120 dB.
LEAST_MSE = 1e-12

Values = TypeVar("Values", jax.Array, np.ndarray)


def srgb_encode(linear: Values) -> Values:
    """sRGB value of linear light (IEC 61966-2-1); NumPy in, NumPy out.

    Nothing is clipped: below 0 the curve goes on as the straight line 12.92 x, so that value and
    gradient are finite everywhere, and above 1 as the same power. Callers that quantise must clip.
    """
    xp: Any = jnp if isinstance(linear, jax.Array) else np
    low = linear <= 0.0031308
    power = xp.where(low, 0.0031308, linear) ** (1 / 2.4)
    return xp.where(low, 12.92 * linear, 1.055 * power - 0.055).astype(linear.dtype)


def srgb_decode(encoded: Values) -> Values:
    """Linear light of an sRGB value: the inverse of `srgb_encode`, unclipped too."""
    xp: Any = jnp if isinstance(encoded, jax.Array) else np
    low = encoded <= 0.04045
    power = ((xp.where(low, 0.04045, encoded) + 0.055) / 1.055) ** 2.4
    return xp.where(low, encoded / 12.92, power).astype(encoded.dtype)


def psnr_from_mse(
    mse: float | np.ndarray | np.floating | jax.Array, *, least: float = 0.0
) -> float:
    """Peak signal-to-noise ratio in dB of a mean squared error between values in 0..1.

    It is -10 log10(mse).

    Args:
        mse: the mean squared error; 0 gives infinity.
        least: a smaller error counts as this one, so that the result is finite; 0 is no limit.
    """
    error = max(float(mse), least)
    return math.inf if error == 0 else -10 * math.log10(error)
