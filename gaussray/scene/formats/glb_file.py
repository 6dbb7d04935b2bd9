"""Reads and writes GLB files, the binary container of glTF 2.0: a JSON document and one buffer."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gaussray.io.atomic import atomic_path
from gaussray.io.safe.files import opened, parse_json
from gaussray.io.safe.limits import within


_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"
# Component types of accessors, and numbers of components by their type.
_FLOAT, _UBYTE = 5126, 5121
_DTYPES: dict[Any, str] = {
    5120: "<i1",
    _UBYTE: "<u1",
    5122: "<i2",
    5123: "<u2",
    5125: "<u4",
    _FLOAT: "<f4",
}
_WIDTHS: dict[Any, int] = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
# The target of vertex attributes.
_ARRAY_BUFFER = 34962


class Glb(NamedTuple):
    """A GLB file: the name for messages, the JSON document, and the bytes of its buffer."""

    name: str
    document: dict[str, Any]
    buffer: bytes

    def refuse(self, rule: str) -> ValueError:
        """The error that says what the file must hold."""
        return ValueError(f"{self.name}: the glTF file must {rule}.")

    def entry(self, kind: str, index: Any) -> dict[str, Any]:
        """An entry of one of the document's lists.

        Args:
            kind: name of the list, such as `nodes`.
            index: place in the list from 0, of any type that the file may hold.

        Raises:
            ValueError: The document has no such entry.
        """
        entries = self.document.get(kind)
        entries = entries if isinstance(entries, list) else []
        there = type(index) is int and 0 <= index < len(entries)
        if not there or not isinstance(entries[index], dict):
            raise self.refuse(f"have the entry {index!s:.20} of {kind}")
        return entries[index]

    def accessor(self, index: Any) -> np.ndarray:
        """The values of an accessor, [count, components] as float64; normalised integers are
        fractions."""
        entry = self.entry("accessors", index)
        dtype, width = _DTYPES.get(entry.get("componentType")), _WIDTHS.get(entry.get("type"))
        if dtype is None or width is None or "sparse" in entry or "bufferView" not in entry:
            raise self.refuse("have plain accessors of vectors: neither sparse nor matrices")
        view, kind = self.entry("bufferViews", entry["bufferView"]), np.dtype(dtype)
        if view.get("buffer") != 0 or view.get("extensions"):
            raise self.refuse("hold its data in its own buffer, uncompressed")
        numbers = [entry.get("count"), view.get("byteLength"), view.get("byteStride", 0)]
        numbers += [entry.get("byteOffset", 0), view.get("byteOffset", 0)]
        if any(type(x) is not int or x < 0 for x in numbers):
            raise self.refuse("have whole numbers as sizes and offsets")
        count, length, stride, inner, outer = numbers
        size = width * kind.itemsize
        step, begin = stride or size, outer + inner
        end = begin + (count - 1) * step + size
        if count < 1 or step < size or end > min(outer + length, len(self.buffer)):
            raise self.refuse("hold as many bytes as its accessors name; it is cut off")
        table = np.ndarray((count, width), kind, self.buffer, begin, (step, kind.itemsize))
        values = table.astype(np.float64)
        if entry.get("normalized") and kind.kind in "iu":
            values = np.maximum(values / np.iinfo(kind).max, -1)
        return values


def read_glb(path: Path | str) -> Glb:
    """Read the container; no values are checked yet.

    Raises:
        ValueError: The file is no GLB of version 2, is cut off, or exceeds a limit.
        FileNotFoundError: The file does not exist.
    """
    with opened(path) as file:
        within(path, "the file in GB", os.fstat(file.fileno()).st_size, "arrays", 1e9)
        data = file.read()
    if len(data) < 20 or data[:4] != _MAGIC or int.from_bytes(data[4:8], "little") != 2:
        raise ValueError(
            f"{path}: must be a binary glTF file of version 2 (GLB), got {data[:4]!r}. Export it "
            "as .glb."
        )
    length = int.from_bytes(data[12:16], "little")
    text, rest = data[20 : 20 + length], data[20 + length :]
    within(path, "the JSON in MB", length, "text", 1e6)
    document = parse_json(path, text)
    size = int.from_bytes(rest[:4], "little")
    buffer = rest[8 : 8 + size] if rest[4:8] == _BIN else b""
    if data[16:20] != _JSON or len(text) < length or len(buffer) < size:
        raise ValueError(f"{path}: the GLB file is cut off. Copy it again.")
    if not isinstance(document, dict):
        raise ValueError(f"{path}: the JSON of a GLB file must be an object.")
    return Glb(str(path), document, buffer)


def write_glb(
    path: Path | str, document: Mapping[str, Any], attributes: Mapping[str, np.ndarray]
) -> None:
    """Write a document with vertex attributes, whose accessors have the order of the mapping.

    Args:
        path: the file.
        document: the JSON, without buffers, buffer views and accessors.
        attributes: arrays [count, components] of float32 or uint8 (normalised), by semantic.

    Raises:
        ValueError: The file would be larger than 4 GB.
        OSError: The file cannot be written.
    """
    parts, views, accessors, end = [], [], [], 0
    for name, array in attributes.items():
        data = np.ascontiguousarray(array).tobytes()
        parts.append(data + bytes(-len(data) % 4))
        views.append(
            {"buffer": 0, "byteOffset": end, "byteLength": len(data), "target": _ARRAY_BUFFER}
        )
        accessors.append(_accessor(len(accessors), name, array))
        end += len(parts[-1])
    tables = {"buffers": [{"byteLength": end}], "bufferViews": views, "accessors": accessors}
    text = json.dumps({**document, **tables}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    total = 28 + len(text) + end
    if total >= 1 << 32:
        raise ValueError(f"{path}: a GLB file must be smaller than 4 GB, got {total / 1e9:.3g} GB.")
    head = _MAGIC + _words(2, total) + _words(len(text)) + _JSON + text + _words(end) + _BIN
    with atomic_path(path) as partial, open(partial, "wb") as file:
        file.write(head)
        file.writelines(parts)


def _accessor(view: int, name: str, array: np.ndarray) -> dict[str, Any]:
    """The accessor of an attribute; positions must have bounds."""
    kinds = {width: name for name, width in _WIDTHS.items()}
    entry = {
        "bufferView": view,
        "componentType": _UBYTE if array.dtype == np.uint8 else _FLOAT,
        "count": len(array),
        "type": kinds[array.shape[1]],
    }
    if array.dtype == np.uint8:
        entry["normalized"] = True
    if name == "POSITION":
        entry |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
    return entry


def _words(*numbers: int) -> bytes:
    return np.array(numbers, "<u4").tobytes()
