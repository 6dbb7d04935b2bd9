"""The optional starting points of a capture: coloured points in a PLY file."""

import warnings
from pathlib import Path
from typing import BinaryIO

import equinox as eqx
import numpy as np
from jaxtyping import Float

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.color import srgb_decode


_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
_ORDERS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
_COLORS = ("red", "green", "blue")


class Points(eqx.Module):
    """Points in world space and their linear light; host arrays."""

    position: Float[np.ndarray, "points 3"]
    color: Float[np.ndarray, "points 3"]


def read_points(path: Path | str) -> Points:
    """Points of a PLY file, ASCII or binary: x y z, and red green blue if it has them.

    Integer colours are sRGB codes, float colours linear light (as in pictures). Without colours all
    are 0.5. Points that are not finite are dropped; both are warned of, with the count.
    """
    path = Path(path)
    with path.open("rb") as file:
        order, elements = _header(path, file)
        table = _vertices(path, file, order, elements)
    names = table.dtype.names or ()
    absent = [name for name in "xyz" if name not in names]
    if absent:
        raise CaptureError(f"{path}: element vertex must have x, y and z, got no {absent[0]}.")
    position = np.stack([table[name] for name in ("x", "y", "z")], axis=-1).astype(np.float32)
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


def _header(path: Path, file: BinaryIO):
    """Byte order and the elements [(name, count, [(property, type, length type or None)])]."""
    if file.readline(64).strip() != b"ply":
        raise CaptureError(
            f"{path}: a PLY file must begin with the line 'ply', got something else."
        )
    order, elements = "", []
    while True:
        raw = file.readline(4096)
        if not raw:
            raise CaptureError(
                f"{path}: the PLY header must end with 'end_header'; it is truncated."
            )
        words = raw.decode("ascii", "replace").split()
        try:
            match words:
                case ["end_header"]:
                    break
                case ["format", name, _]:
                    order = name
                case ["element", name, count]:
                    elements.append((name, int(count), []))
                case ["property", "list", length, kind, name]:
                    elements[-1][2].append((name, _TYPES[kind], _TYPES[length]))
                case ["property", kind, name]:
                    elements[-1][2].append((name, _TYPES[kind], None))
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise ValueError
        except (ValueError, KeyError, IndexError):
            line = " ".join(words)
            raise CaptureError(f"{path}: the PLY header has a malformed line: {line!r}.") from None
    if order not in _ORDERS:
        raise CaptureError(
            f"{path}: the PLY format must be one of {', '.join(_ORDERS)}, got {order!r}."
        )
    return _ORDERS[order], elements


def _vertices(path, file, order, elements) -> np.ndarray:
    for name, count, properties in elements:
        if name == "vertex":
            if any(length for _, _, length in properties):
                raise CaptureError(f"{path}: element vertex must not have list properties.")
            kinds = np.dtype([(name, (order or "<") + kind) for name, kind, _ in properties])
            read = _ascii_table if order is None else _binary_table
            return read(path, file, kinds, count)
        _skip(path, file, order, count, properties)
    raise CaptureError(f"{path}: the PLY file must have an element vertex, got none.")


def _binary_table(path, file, kinds, count):
    data = file.read(count * kinds.itemsize)
    if len(data) < count * kinds.itemsize:
        raise _truncated(path, len(data) // max(kinds.itemsize, 1), count)
    return np.frombuffer(data, kinds, count)


def _ascii_table(path, file, kinds, count):
    table = np.empty(count, kinds)
    for row in range(count):
        words = file.readline().split()
        if not words:
            raise _truncated(path, row, count)
        try:
            if len(words) != len(kinds):
                raise ValueError
            table[row] = tuple(
                int(word) if kinds[k].kind in "iu" else float(word) for k, word in enumerate(words)
            )
        except (ValueError, OverflowError):
            raise CaptureError(
                f"{path}: vertex {row} must hold the {len(kinds)} numbers of the header, "
                f"got {b' '.join(words).decode('ascii', 'replace')!r}."
            ) from None
    return table


def _skip(path, file, order, count, properties):
    """Pass over an element that stands before the vertices."""
    for row in range(count):
        if order is None:
            if not file.readline():
                raise _truncated(path, row, count)
            continue
        for _, kind, length in properties:
            times = 1
            if length:
                size = np.dtype(order + length)
                raw = file.read(size.itemsize)
                if len(raw) < size.itemsize:
                    raise _truncated(path, row, count)
                times = int(np.frombuffer(raw, size)[0])
            file.seek(times * np.dtype(kind).itemsize, 1)


def _truncated(path, got, count):
    return CaptureError(
        f"{path}: the PLY data must hold the {count} rows of the header, got {got}; "
        "the file is truncated. Copy it again."
    )
