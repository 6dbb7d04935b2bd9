"""Frames of videos in high dynamic range, as phones record them, as sRGB levels.

Light stays proportional up to a share of the reference white of ITU-R BT.2408, `_KNEE`. What is
brighter is compressed (extended Reinhard), so that the brightest becomes white: phones put plain
walls above reference white, whose details would be lost otherwise. Both were chosen by eye, on one
phone's video.
"""

import functools
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from gaussray.color import srgb_encode


# Transfer characteristics and primaries of ITU-T H.273.
HIGH_RANGE_CURVES = {16: "PQ", 18: "HLG"}
_BT2020 = 9
# Linear light of BT.2020 to that of BT.709, whose primaries are sRGB's (ITU-R BT.2087).
_TO_SRGB = np.array(
    [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32
)
# The HLG curve of ITU-R BT.2100, and its signal for reference white (BT.2408).
_A, _B, _C, _WHITE = 0.17883277, 0.28466892, 0.55991073, 0.75
# The PQ curve of ITU-R BT.2100, and reference white in cd/m2.
_M1, _M2, _C1, _C2, _C3, _NITS = 0.1593017578125, 78.84375, 0.8359375, 18.8515625, 18.6875, 203.0
# Share of reference white from which on light is compressed, and what becomes white.
_KNEE, _PEAK = 0.4, {"HLG": 3.774, "PQ": 10.0}
_STEPS = 65535


def curve_of(frame: Any) -> str:
    """Name of a frame's curve, if it is one of high dynamic range; otherwise empty.

    Args:
        frame: the frame, as PyAV gives it.
    """
    return HIGH_RANGE_CURVES.get(int(getattr(frame, "color_trc", 0) or 0), "")


def relative_light(
    signal: Float[np.ndarray, "*values"], curve: str
) -> Float[np.ndarray, "*values"]:
    """Linear light of a signal in 0..1, as a share of reference white.

    Args:
        signal: encoded values.
        curve: `HLG`, of which it is the light of the scene, or `PQ`, that of the display.
    """
    if curve == "HLG":
        return _hlg_light(signal) / _hlg_light(np.array([_WHITE]))
    root = np.maximum(signal, 0) ** (1 / _M2)
    return 10000 / _NITS * (np.maximum(root - _C1, 0) / (_C2 - _C3 * root)) ** (1 / _M1)


def _hlg_light(signal: Float[np.ndarray, " values"]) -> Float[np.ndarray, " values"]:
    above = (np.exp((np.maximum(signal, 0.5) - _C) / _A) + _B) / 12
    return np.where(signal <= 0.5, signal**2 / 3, above)


def standard_levels(
    signal: UInt16[np.ndarray, "h w 3"], curve: str, *, wide: bool
) -> UInt8[np.ndarray, "h w 3"]:
    """sRGB levels of a picture in high dynamic range.

    Args:
        signal: encoded red, green and blue in 0..65535.
        curve: `HLG` or `PQ`.
        wide: whether its primaries are BT.2020's; otherwise they are taken for sRGB's.
    """
    light = _lights(curve)[signal]
    if wide:
        light = np.maximum(light @ _TO_SRGB.T, 0)
    # All channels by one factor, which keeps the hue.
    most = light.max(axis=-1, keepdims=True)
    over = np.maximum(most - _KNEE, 0) / (1 - _KNEE)
    peak = (_PEAK[curve] - _KNEE) / (1 - _KNEE)
    less = _KNEE + (1 - _KNEE) * over / (1 + over) * (1 + over / peak**2)
    light *= np.where(over > 0, less / np.maximum(most, _KNEE), 1)
    return _levels()[np.minimum(_STEPS * light + 0.5, _STEPS).astype(np.uint16)]


@functools.cache
def _lights(curve: str) -> Float[np.ndarray, " values"]:
    return relative_light(np.arange(_STEPS + 1) / _STEPS, curve).astype(np.float32)


@functools.cache
def _levels() -> UInt8[np.ndarray, " values"]:
    """The sRGB level of each linear value."""
    return np.round(255 * srgb_encode(np.arange(_STEPS + 1) / _STEPS)).astype(np.uint8)


def frame_levels(frame: Any) -> UInt8[np.ndarray, "h w 3"]:
    """sRGB levels of a frame of any curve.

    Args:
        frame: the frame, as PyAV gives it.
    """
    curve = curve_of(frame)
    if not curve:
        return frame.to_ndarray(format="rgb24")
    wide = int(getattr(frame, "color_primaries", 0) or 0) == _BT2020
    return standard_levels(frame.to_ndarray(format="rgb48le"), curve, wide=wide)
