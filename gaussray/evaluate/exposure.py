"""Exposures of pictures: renderings as a camera records them, and scores after the best gain."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from gaussray.color import srgb_decode
from gaussray.dataset.images import srgb_levels
from gaussray.evaluate.metrics import psnr


# Linear light of the 256 levels.
_LIGHT = srgb_decode(np.arange(256) / 255)


class ExposureMatch(NamedTuple):
    """A rendering after the best gain of each channel.

    Args:
        psnr: PSNR in dB after it.
        stops: logarithm to base 2 of the best gain of all channels together; NaN where truth or
            rendering is black.
    """

    psnr: float
    stops: float


def recorded_levels(
    light: Float[np.ndarray, "h w 3"], response: Float[np.ndarray, "3 3"] | None
) -> UInt8[np.ndarray, "h w 3"]:
    """8-bit sRGB levels of linear light as a camera records it.

    Args:
        light: linear light; 1 is white.
        response: the camera's matrix of linear red, green and blue; None: light as it is.
    """
    return srgb_levels(light if response is None else light @ response.T.astype(light.dtype))


def exposure_match(
    truth: UInt8[np.ndarray, "h w 3"],
    image: UInt8[np.ndarray, "h w 3"],
    mask: Bool[np.ndarray, "h w"] | None = None,
) -> ExposureMatch:
    """Compare two pictures after the gain of each channel, in linear light, that brings the second
    one nearest to the first (least squares): sum(truth image) / sum(image^2).

    It is the colour-corrected PSNR of Mip-NeRF 360 with gains in place of an affine map.

    Args:
        truth: the picture, in sRGB levels.
        image: the rendering, in sRGB levels.
        mask: pixels that count; None: all.
    """
    real, ours = (_LIGHT[x if mask is None else x[mask]].reshape(-1, 3) for x in (truth, image))
    both, own = np.sum(real * ours, axis=0), np.sum(ours**2, axis=0)
    gain = np.divide(both, own, out=np.ones(3), where=own > 0)
    black = not both.any()
    stops = float("nan") if black else float(np.log2(both.sum() / own.sum()))
    return ExposureMatch(psnr(truth, srgb_levels(gain * _LIGHT[image]), mask), stops)
