"""The optional starting points of a capture: coloured points in a PLY file."""

import warnings
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Float

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.world_origin import counted_positions
from gaussray.color import srgb_decode
from gaussray.io.ply import read_vertices


_COLORS = ("red", "green", "blue")


class Points(eqx.Module):
    """Points in world space and their linear light; host arrays."""

    position: Float[np.ndarray, "points 3"]
    color: Float[np.ndarray, "points 3"]


def read_points(path: Path | str) -> Points:
    """Read the points of an ASCII or binary PLY file: x y z and, if present, red green blue.

    Integer colours are sRGB values, float colours linear light (as in pictures). Without colours,
    all are 0.5, with a warning. Points that are not finite are dropped, with a warning.

    Raises:
        CaptureError: the file is malformed, or holds no finite point.
    """
    path = Path(path)
    try:
        table = read_vertices(path)
    except ValueError as error:
        raise CaptureError(str(error)) from None
    names = table.dtype.names or ()
    absent = [name for name in "xyz" if name not in names]
    if absent:
        raise CaptureError(f"{path}: element vertex must have x, y and z, got no {absent[0]}.")
    position = counted_positions(np.stack([table[name] for name in ("x", "y", "z")], axis=-1))
    position = position.astype(np.float32)
    color = _colors(path, table, names)
    finite = np.isfinite(position).all(axis=-1) & np.isfinite(color).all(axis=-1)
    if not finite.any():
        raise CaptureError(f"{path}: at least one point must be finite, got none of {len(table)}.")
    if not finite.all():
        _warn(f"{path}: {int((~finite).sum())} of {len(table)} points are not finite and dropped.")
    return Points(position[finite], color[finite])


def _colors(path, table, names):
    if any(name not in names for name in _COLORS):
        _warn(f"{path}: the points have no red, green and blue; all are gray 0.5.")
        return np.full((len(table), 3), 0.5, np.float32)
    stored = [table[name] for name in _COLORS]
    scale = [np.iinfo(c.dtype).max if c.dtype.kind in "iu" else 0 for c in stored]
    if not any(scale):
        color = np.stack(stored, axis=-1).astype(np.float32)
        if np.nanmax(color, initial=0) > 16:
            _warn(
                f"{path}: float colours are read as linear light, and the largest is "
                f"{np.nanmax(color)}. Store 8-bit codes as uchar."
            )
        return color
    encoded = [c / (s or 1) for c, s in zip(stored, scale, strict=True)]
    return srgb_decode(np.stack(encoded, axis=-1).astype(np.float64)).astype(np.float32)


def _warn(message):
    warnings.warn(message, CaptureWarning, stacklevel=4)
