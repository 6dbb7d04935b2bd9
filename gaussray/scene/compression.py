"""Quantised arrays: a scene in about a quarter of its bytes.

Every large array passes a curve on which equal steps look alike, and is rounded there to multiples
of a power of two. These are exact in floating point, so a scene that was read is written again
without another loss. Gaussians are sorted in Morton order, where neighbours are similar. The
integers, or their differences to their neighbours if these are smaller, are split into planes of
bytes, low bytes apart from high bytes, which deflate well.

    array            curve                                  step
    mean             x                                      1/16 to 1/32 of the least extent of all
                                                            but the thinnest twentieth
    quat             x, of unit length                      1/1024
    scale            log2 x                                 1/64
    opacity          x                                      1/128
    harmonics        sRGB code of C0 x + 1/2; x             1/256; 1/128
    planes           x                                      1/128 of the largest number
    weight, bias     x                                      1/256 of the largest number
    velocity         x                                      a step of the mean in 4 long lifetimes
    instant, plateau x                                      1/32 to 1/64 of a short lifetime
    lifetime         log2 x                                 1/64
    log_gain         x                                      1/256

The largest number counts as the next power of two. A long lifetime is one that a twentieth of the
transient Gaussians exceed, a short one is one that all but a twentieth exceed. An array is off by
half a step on its curve at most, and by the rounding of its own precision. The steps cost pictures
about equally much, and all of them together 57 dB of PSNR against the scene as it was, for scenes
that were fitted. All else is exact: instants and boxes of deformations, bodies, whose turns move
what is far from their pivots, and what a `ResidualField` adds to (quat, logit_opacity).
"""

import math
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gaussray.color import srgb_decode, srgb_encode
from gaussray.scene.harmonics import C0


# Bytes of a plane by which its deflation is judged.
_PIECE = 1 << 16
# Logarithms to base 2 of the steps: in themselves,
_QUAT, _SCALE, OPACITY, _COLOR, HARMONICS, _LOG_GAIN = -10, -6, -7, -8, -7, -8
# and in units of the largest number,
PLANES, NETWORK = -7, -8
# of a short lifetime,
INSTANT = -5
# and of the least extent that all but a share THIN of the Gaussians exceed.
_MEAN, THIN = -4, 0.05


class Code(NamedTuple):
    """How an array was quantised.

    Args:
        curve: name of the curve, of `CURVES`.
        exponent: logarithm of the step to base 2.
        difference: axis along which neighbours were subtracted; None for none.
        shape: shape of the array.
        dtype: its type.
    """

    curve: str
    exponent: int
    difference: int | None
    shape: list[int]
    dtype: str


def _to_color(x: np.ndarray) -> np.ndarray:
    return np.concatenate([srgb_encode(C0 * x[:, :1] + 0.5), x[:, 1:] * _REST], axis=1)


def _from_color(x: np.ndarray) -> np.ndarray:
    return np.concatenate([(srgb_decode(x[:, :1]) - 0.5) / C0, x[:, 1:] / _REST], axis=1)


# So that one step does for all harmonics.
_REST = 2.0 ** (_COLOR - HARMONICS)
CURVES: dict[str, tuple[Callable, Callable]] = {
    "linear": (lambda x: x, lambda x: x),
    "log2": (lambda x: np.log2(np.maximum(x, np.finfo(np.float32).tiny)), np.exp2),
    "color": (_to_color, _from_color),
}


def compress_arrays(
    array: dict[str, np.ndarray],
) -> tuple[dict[str, dict[str, Any]], dict[str, np.ndarray]]:
    """Quantise the arrays of a scene.

    Args:
        array: the arrays by name (`named_arrays`).

    Returns:
        The fields of the `Code` of each quantised array, by name; and all arrays, the quantised
        ones as bytes, Gaussians in Morton order.

    Raises:
        ValueError: An array is not finite.
    """
    array, numbers, steps = dict(array), {}, {}
    for name, (curve, exponent) in _steps(array).items():
        if not np.isfinite(array[name]).all():
            raise ValueError(f"the array '{name}' must be finite to be kept compactly.")
        x = CURVES[curve][0](_unit_quaternions(name, array[name].astype(np.float64)))
        numbers[name] = np.rint(np.ldexp(x, -exponent)).astype(np.int64)
        steps[name] = curve, exponent
    for prefix in _kinds(array):
        order = _morton(numbers[f"{prefix}.mean"])
        for table in (array, numbers):
            for name in table:
                if name.startswith(f"{prefix}.") or (prefix, name) == ("moving", _LOGIT):
                    table[name] = table[name][order]
    codes = {}
    for name, x in numbers.items():
        dtype = array[name].dtype.name
        array[name], difference = _pack(x)
        curve, exponent = steps[name]
        codes[name] = Code(curve, exponent, difference, list(x.shape), dtype)._asdict()
    return codes, array


def restore_arrays(
    codes: dict[str, Any], array: dict[str, np.ndarray], path: Path
) -> dict[str, np.ndarray]:
    """The inverse of `compress_arrays`.

    Args:
        codes: the codes of quantised arrays, by name.
        array: all arrays.
        path: the file, for messages.

    Raises:
        ValueError: A code does not fit its bytes.
    """
    arrays = dict(array)
    for name, code in codes.items():
        try:
            arrays[name] = _restore_array(Code(**code), array[name])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"{path}: the code of '{name:.80}' is damaged ({error}).") from error
    return arrays


def _restore_array(code: Code, planes: np.ndarray) -> np.ndarray:
    curve, dtype = CURVES[code.curve][1], {"float32": np.float32, "float64": np.float64}[code.dtype]
    if planes.dtype != np.uint8 or planes.ndim != 2 or not 0 < len(planes) <= 8:
        raise ValueError(f"bytes of type {planes.dtype} and shape {planes.shape}")
    if min(code.shape, default=0) < 0:
        raise ValueError(f"a shape of {code.shape}")
    if abs(code.exponent) > 1000:
        raise ValueError(f"a step of 2^{code.exponent}")
    number = np.zeros(planes.shape[1], np.uint64)
    for i, plane in enumerate(planes):
        number |= plane.astype(np.uint64) << np.uint64(8 * i)
    x = (number >> np.uint64(1)).astype(np.int64) ^ -(number & np.uint64(1)).astype(np.int64)
    x = x.reshape(code.shape[::-1]).T
    if code.difference is not None:
        x = np.cumsum(x, axis=code.difference)
    # What overflows is not finite, and refused as such.
    with np.errstate(all="ignore"):
        return curve(np.ldexp(x.astype(np.float64), code.exponent)).astype(dtype)


_LOGIT = "deformation.logit_opacity"


def _steps(array: dict[str, np.ndarray]) -> dict[str, tuple[str, int]]:
    """Curve and logarithm of the step of every array that is rounded."""
    steps = {}
    residual = "deformation.encoded" in array
    for prefix in _kinds(array):
        scale = array[f"{prefix}.scale"]
        steps[f"{prefix}.mean"] = "linear", _MEAN + _thin_extent(scale)
        steps[f"{prefix}.scale"] = "log2", _SCALE
        steps[f"{prefix}.opacity"] = "linear", OPACITY
        steps[f"{prefix}.harmonics"] = "color", _COLOR
        if prefix != "moving" or not residual:
            steps[f"{prefix}.quat"] = "linear", _QUAT
    if "transient.lifetime" in array:
        short, long = (_lifetime(array["transient.lifetime"], x) for x in (THIN, 1 - THIN))
        steps["transient.lifetime"] = "log2", _SCALE
        steps["transient.instant"] = steps["transient.plateau"] = "linear", INSTANT + short
        steps["transient.velocity"] = "linear", steps["transient.mean"][1] - long - 3
    for name, x in array.items():
        if name.startswith(("deformation.planes.space.", "deformation.planes.time.")):
            steps[name] = "linear", PLANES + _largest_exponent(x)
        elif name.endswith((".weight", ".bias")):
            steps[name] = "linear", NETWORK + _largest_exponent(x)
        elif name == "shading.log_gain":
            steps[name] = "linear", _LOG_GAIN
    return steps


def _thin_extent(scale: np.ndarray) -> int:
    """Logarithm of the extent that a share THIN of the Gaussians does not have, rounded down.

    Of extents that are rounded already, so that it comes out the same the next time.
    """
    least = np.sort(np.rint(np.ldexp(CURVES["log2"][0](scale.astype(np.float64)), -_SCALE)).min(1))
    return math.floor(math.ldexp(least[int(THIN * len(least))], _SCALE)) if len(least) else 0


def _lifetime(lifetime: np.ndarray, share: float) -> int:
    """Logarithm of the lifetime that a share of the transient Gaussians do not reach, rounded down:
    of lifetimes that are rounded already, as in `_thin_extent`."""
    rounded = np.sort(np.rint(np.ldexp(CURVES["log2"][0](lifetime.astype(np.float64)), -_SCALE)))
    if not len(rounded):
        return 0
    return math.floor(math.ldexp(rounded[int(share * len(rounded))], _SCALE))


def _kinds(array: dict[str, np.ndarray]) -> list[str]:
    """Prefixes of the Gaussians that there are."""
    return [prefix for prefix in ("static", "moving", "transient") if f"{prefix}.mean" in array]


def _largest_exponent(x: np.ndarray) -> int:
    """Logarithm of the largest number, rounded up."""
    largest = float(np.abs(x).max(initial=0))
    return math.ceil(math.log2(largest)) if largest else 0


def _unit_quaternions(name: str, x: np.ndarray) -> np.ndarray:
    """Quaternions of unit length; rounded ones, whose length is nearly 1, stay as they are."""
    if not name.endswith(".quat"):
        return x
    length = np.linalg.norm(x, axis=1, keepdims=True)
    number = np.ldexp(x, -_QUAT)
    rounded = (abs(length - 1) <= 2.0**_QUAT) & (number == np.rint(number)).all(1, keepdims=True)
    return np.where(rounded, x, x / np.where(length > 0, length, 1))


def _morton(number: np.ndarray) -> np.ndarray:
    """Order along the Z-curve of places given as whole numbers."""
    if not len(number):
        return np.arange(0)
    place = number - number.min(axis=0)
    place = (place >> max(int(place.max()).bit_length() - 21, 0)).astype(np.uint64)
    key = np.zeros(len(place), np.uint64)
    for bit in range(21):
        for axis in range(3):
            key |= (place[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(key, kind="stable")


def _pack(number: np.ndarray) -> tuple[np.ndarray, int | None]:
    """Planes of bytes, lowest first, and the axis of the differences that deflate best: judged by
    rows from the middle, since deflating millions of numbers for every choice would take longer
    than writing the file."""
    rows = max(_PIECE // max(math.prod(number.shape[1:]), 1), 1)
    first = max((len(number) - rows) // 2, 0)
    piece = number[first : first + rows]

    def size(axis: int | None) -> int:
        return len(zlib.compress(_planes(piece, axis).tobytes()))

    best = min((None, *range(number.ndim)), key=size)
    return _planes(number, best), best


def _planes(number: np.ndarray, axis: int | None) -> np.ndarray:
    """The bytes of numbers, or of their differences along an axis, lowest first."""
    x = number if axis is None else np.diff(number, axis=axis, prepend=0)
    x = x.T.reshape(-1)
    # The sign goes into the lowest bit: small numbers have empty high bytes.
    folded = (x << 1 ^ x >> 63).astype(np.uint64)
    count = max((int(folded.max(initial=0)).bit_length() + 7) // 8, 1)
    return np.stack([(folded >> np.uint64(8 * i)).astype(np.uint8) for i in range(count)])
