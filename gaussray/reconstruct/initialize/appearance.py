"""The appearance of points and pixels that tracking compares: colour more than brightness."""

from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped
from scipy.ndimage import gaussian_filter

from gaussray.color import Values, srgb_decode
from gaussray.geometry import product


# Linear light below which a colour means little.
DARK = 0.005
# Weights of colour (sum over channels), of brightness, and of whether a pixel changes at all.
COLOR, BRIGHTNESS, CHANGES = 0.4, 0.1, 0.3


class Shown(NamedTuple):
    """Pictures of some frames (sRGB-encoded), which pixels differ from their temporal median, and
    which are not masked (None: all)."""

    picture: Shaped[np.ndarray, "frames h w 3"]
    moved: Bool[np.ndarray, "frames h w"]
    visible: Bool[np.ndarray, "frames h w"] | None


def layers(
    shown: Shown, shrink: int, blur: tuple[float, ...]
) -> list[Float[Array, "frames rows columns 5"]]:
    """What pixels look like at every blur; NaN where they are hidden.

    Args:
        shown: pictures of some frames.
        shrink: so many times smaller than the pictures are the layers.
        blur: standard deviation of each layer's blur, in its own pixels.
    """
    height, width = (side // shrink for side in shown.picture.shape[1:3])
    matrices = [(_blurring(height, sigma), _blurring(width, sigma)) for sigma in blur]
    # One by one: a program for any number of frames, and memory for one on the device.
    frames = [
        _layers_of_frame(
            picture, moved, None if shown.visible is None else shown.visible[i], shrink, matrices
        )
        for i, (picture, moved) in enumerate(zip(shown.picture, shown.moved, strict=True))
    ]
    return [jnp.stack(layer) for layer in zip(*frames, strict=True)]


@partial(jax.jit, static_argnames="shrink")
def _layers_of_frame(
    picture: Shaped[Array, "h w 3"],
    moved: Bool[Array, "h w"],
    visible: Bool[Array, "h w"] | None,
    shrink: int,
    matrices: list[tuple[Float[Array, "rows rows"], Float[Array, "columns columns"]]],
) -> list[Float[Array, "rows columns 5"]]:
    """`layers` of one picture, by the matrices that blur its columns and its rows."""
    scale = 255 if picture.dtype == jnp.uint8 else 1
    light = srgb_decode(_shrunk(picture, shrink) / scale)
    # Zeros of the matrices would not keep out a pixel that is not a number.
    light = jnp.where(jnp.isfinite(light), light, 0)
    changes = CHANGES * _shrunk(moved[..., None], shrink)
    sharp = jnp.concatenate([look(light), changes], axis=-1)
    hidden = False if visible is None else _shrunk(~visible[..., None], shrink) > 0
    return [
        jnp.where(hidden, jnp.nan, product("ij,jkc,lk->ilc", down, sharp, along))
        for down, along in matrices
    ]


@lru_cache(maxsize=16)
def _blurring(pixels: int, sigma: float) -> Float[np.ndarray, "pixels pixels"]:
    """The matrix that blurs a line of pixels."""
    return gaussian_filter(np.eye(pixels, dtype=np.float32), (sigma, 0))


def _shrunk(picture: Shaped[Array, "h w c"], factor: int) -> Float[Array, "small_h small_w c"]:
    """Means of blocks of factor x factor pixels."""
    height, width, channels = picture.shape
    height, width = height // factor, width // factor
    block = picture[: height * factor, : width * factor].astype(jnp.float32)
    return block.reshape(height, factor, width, factor, channels).mean(axis=(1, 3))


def look(light: Values) -> Values:
    """Red, green and blue (last axis) over their mean, and a little of their brightness."""
    xp: Any = jnp if isinstance(light, jax.Array) else np
    light = xp.maximum(light, 0)
    mean = light.mean(axis=-1, keepdims=True)
    return xp.concatenate([COLOR * light / (mean + DARK), BRIGHTNESS * xp.sqrt(mean)], axis=-1)
