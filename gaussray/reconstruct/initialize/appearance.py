"""The appearance of points and pixels that tracking compares: colour more than brightness."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped
from scipy.ndimage import gaussian_filter

from gaussray.color import srgb_decode


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
) -> list[Float[Array, "frames h w 5"]]:
    """What pixels look like at every blur; NaN where they are hidden.

    Args:
        shown: pictures of some frames.
        shrink: so many times smaller than the pictures are the layers.
        blur: standard deviation of each layer's blur, in its own pixels.
    """
    scale = 255 if shown.picture.dtype == np.uint8 else 1
    light = srgb_decode(_shrunk(shown.picture, shrink) / scale)
    changes = CHANGES * _shrunk(shown.moved[..., None], shrink)
    sharp = np.concatenate([look(light), changes], axis=-1)
    blurred = [gaussian_filter(sharp, (0, sigma, sigma, 0)) for sigma in blur]
    if shown.visible is not None:
        some = _shrunk(~shown.visible[..., None], shrink) > 0
        blurred = [np.where(some, np.nan, layer) for layer in blurred]
    return [jnp.asarray(layer, jnp.float32) for layer in blurred]


def _shrunk(picture: np.ndarray, factor: int) -> np.ndarray:
    """Means of blocks of factor x factor pixels."""
    _, height, width, channels = picture.shape
    height, width = height // factor, width // factor

    # One by one: in single precision all together would take four times their memory.
    def one(frame: np.ndarray) -> np.ndarray:
        block = frame[: height * factor, : width * factor].astype(np.float32)
        return block.reshape(height, factor, width, factor, channels).mean(axis=(1, 3))

    return np.stack([one(frame) for frame in picture])


def look(light: Float[np.ndarray, "*any 3"]) -> Float[np.ndarray, "*any 4"]:
    """Red, green and blue over their mean, and a little of their brightness."""
    light = np.maximum(light, 0)
    mean = light.mean(axis=-1, keepdims=True)
    return np.concatenate([COLOR * light / (mean + DARK), BRIGHTNESS * np.sqrt(mean)], axis=-1)
