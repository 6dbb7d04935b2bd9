"""Levels of 8 bits: light rounded to the nearest level, on the host and on a device."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from gaussray.color import srgb_decode


class LevelTable(NamedTuple):
    """Levels of single-precision numbers, looked up by the upper 16 of their 32 bits.

    At most one edge between two levels lies among the numbers with the same upper bits. A lookup
    and a comparison are therefore exact, and several times faster than the power of a curve.

    Args:
        level: level of the smallest of these numbers.
        edge: the smallest number of the next level; infinity if it is not among them.
    """

    level: UInt8[np.ndarray, "65536"]
    edge: Float[np.ndarray, "65536"]


def srgb_table() -> LevelTable:
    """The levels of linear light, encoded by the sRGB curve."""
    return _level_table(srgb_decode)


def encoded_table() -> LevelTable:
    """The levels of values that are encoded already."""
    return _level_table(_unchanged)


@cache
def _level_table(decode: Callable[[np.ndarray], np.ndarray]) -> LevelTable:
    """The levels of a rising curve from 0 to 1.

    Args:
        decode: inverse of the curve.
    """
    exact = decode((np.arange(1, 256) - 0.5) / 255)
    edges = exact.astype(np.float32)
    # Rounded up, because a number belongs to the next level from the exact edge on.
    edges = np.where(edges < exact, np.nextafter(edges, np.float32(2)), edges)
    smallest = (np.arange(1 << 15, dtype=np.uint32) << 16).view(np.float32)
    level = np.searchsorted(edges, smallest, side="right")
    edge = np.append(edges, np.float32(np.inf))[level]
    # The upper half of the table are numbers below 0.
    return LevelTable(
        np.append(level, np.zeros(1 << 15)).astype(np.uint8),
        np.append(edge, np.full(1 << 15, np.inf)).astype(np.float32),
    )


def _unchanged(encoded: np.ndarray) -> np.ndarray:
    return encoded


def host_levels(
    light: Float[np.ndarray, "*shape"], table: LevelTable
) -> UInt8[np.ndarray, "*shape"]:
    """Levels of numbers on the host.

    Args:
        light: finite numbers in single precision.
        table: the levels.
    """
    # The upper half of each number, in the order of bytes of every machine that JAX runs on.
    upper = np.ascontiguousarray(light).view(np.uint16)[..., 1::2]
    return table.level.take(upper) + (light >= table.edge.take(upper))


def device_levels(light: Float[Array, "*shape"], table: LevelTable) -> UInt8[Array, "*shape"]:
    """Levels of numbers on a device, equal to those of `host_levels`.

    Args:
        light: finite numbers; others get any level. Double precision is rounded to single.
        table: the levels.
    """
    light = light.astype(jnp.float32)
    upper = (jax.lax.bitcast_convert_type(light, jnp.uint32) >> 16).astype(jnp.int32)
    level, edge = jnp.asarray(table.level), jnp.asarray(table.edge)
    return level[upper] + (light >= edge[upper]).astype(jnp.uint8)


def require_finite(unfit: int) -> None:
    """Check that a picture can be stored in 8 bits.

    Args:
        unfit: how many of its values are not finite.

    Raises:
        ValueError: Some are not.
    """
    if unfit:
        raise ValueError(
            f"a picture stored in 8 bits must be finite, got {unfit} values that are not. Lower "
            "sensor.exposure, or store light (format=exr)."
        )
