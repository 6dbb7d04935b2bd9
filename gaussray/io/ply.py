"""Reads untrusted PLY files (Turk 1994)."""

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from gaussray.io.safe.files import opened
from gaussray.io.safe.limits import within


_KINDS = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
# Byte order of each format; empty for text.
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


class _Property(NamedTuple):
    """A column of an element; `length` is the type of a list's length."""

    name: str
    kind: str
    length: str | None = None


class _Element(NamedTuple):
    name: str
    count: int
    properties: list[_Property]


class _Header(NamedTuple):
    """Byte order, elements, and the words of each comment."""

    order: str
    elements: list[_Element]
    comments: list[list[str]]


def read_vertices(path: Path | str) -> np.ndarray:
    """The element `vertex` of an ASCII or binary PLY file (`read_elements`).

    Returns:
        A record array with the names and types of the file's properties.
    """
    return read_elements(path, ("vertex",))["vertex"]


def read_elements(path: Path | str, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Elements of an ASCII or binary PLY file, as record arrays with the names and types of the
    file's properties.

    Other elements are skipped. Memory is allocated only for data that the file holds.

    Args:
        path: the file.
        names: the elements, of which `vertex` must be there.

    Returns:
        The elements that the file has, by name.

    Raises:
        ValueError: the header is malformed, data are truncated, text is not a number of its type,
            or there are more points than limits.points.
        OSError: the file is missing or cannot be read.
    """
    path, found = Path(path), dict[str, np.ndarray]()
    with opened(path) as file:
        header = _header(path, file)
        last = max((i for i, e in enumerate(header.elements) if e.name in names), default=-1)
        for element in header.elements[: last + 1]:
            if element.name in names:
                found[element.name] = _table(path, file, header.order, element)
            else:
                _skip(path, file, header.order, element)
    if "vertex" not in found:
        raise ValueError(f"{path}: the PLY file must have an element vertex, got none.")
    return found


def element_names(path: Path | str) -> dict[str, tuple[str, ...]]:
    """The names of the properties of each element of a PLY file, from its header alone."""
    with opened(path) as file:
        elements = _header(Path(path), file).elements
    return {e.name: tuple(p.name for p in e.properties) for e in elements}


def comments_of(path: Path | str) -> dict[str, str]:
    """The comments of a PLY file's header: what follows the first word, by that word."""
    with opened(path) as file:
        lines = _header(Path(path), file).comments
    return {words[0]: " ".join(words[1:]) for words in lines if words}


def _table(path: Path, file: BinaryIO, order: str, element: _Element) -> np.ndarray:
    name = element.name
    if any(p.length for p in element.properties):
        raise ValueError(f"{path}: element {name} must not have list properties.")
    if not element.properties:
        raise ValueError(f"{path}: element {name} must have properties, got none.")
    try:
        kind = np.dtype([(p.name, (order or "<") + p.kind) for p in element.properties])
    except ValueError as error:
        raise ValueError(f"{path}: element {name} is malformed: {error}.") from None
    return (_binary if order else _text)(path, file, kind, element.count)


def _header(path: Path, file: BinaryIO) -> _Header:
    if file.readline(64).strip() != b"ply":
        raise ValueError(f"{path}: a PLY file must begin with the line 'ply', got something else.")
    order, elements, comments = None, [], []
    while raw := file.readline(4096):
        words = raw.decode("ascii", "replace").split()
        try:
            match words:
                case ["end_header"]:
                    break
                case ["format", name, _]:
                    order = name
                case ["element", name, count] if count.isdigit():
                    elements.append(_Element(name, int(count), []))
                case ["property", "list", length, kind, name]:
                    elements[-1].properties.append(_Property(name, _KINDS[kind], _KINDS[length]))
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, _KINDS[kind]))
                case ["comment", *said]:
                    comments.append(said)
                case [] | ["obj_info", *_]:
                    pass
                case _:
                    raise ValueError
        except (ValueError, KeyError, IndexError):
            line = " ".join(words)
            raise ValueError(f"{path}: the PLY header has a malformed line: {line!r}.") from None
    else:
        raise ValueError(f"{path}: the PLY header must end with 'end_header'; it is truncated.")
    if order not in _ORDERS:
        raise ValueError(
            f"{path}: the PLY format must be one of {', '.join(_ORDERS)}, got {order!r}."
        )
    return _Header(_ORDERS[order], elements, comments)


def _skip(path: Path, file: BinaryIO, order: str, element: _Element) -> None:
    if not order:
        got = sum(1 for _ in islice(file, min(element.count, _left(file))))
        if got < element.count:
            raise _truncated(path, got, element.count)
        return
    size = sum(np.dtype(p.kind).itemsize for p in element.properties)
    if not any(p.length for p in element.properties):
        file.seek(min(element.count * size, _left(file)), 1)
        return
    for row in range(element.count):
        for p in element.properties:
            times = 1
            if p.length:
                size = np.dtype(order + p.length)
                raw = file.read(size.itemsize)
                if len(raw) < size.itemsize:
                    raise _truncated(path, row, element.count)
                times = int(np.frombuffer(raw, size)[0])
            # A negative length would seek backwards, in an endless loop.
            room = times * np.dtype(p.kind).itemsize
            if not 0 <= room <= _left(file):
                raise _truncated(path, row, element.count)
            file.seek(room, 1)


def _binary(path: Path, file: BinaryIO, kind: np.dtype, count: int) -> np.ndarray:
    left = _left(file) // kind.itemsize
    if left < count:
        raise _truncated(path, left, count)
    within(path, "the millions of points", count, "points", 1e6)
    return np.frombuffer(file.read(count * kind.itemsize), kind, count)


def _text(path: Path, file: BinaryIO, kind: np.dtype, count: int) -> np.ndarray:
    within(path, "the text in MB", _left(file), "text", 1e6)
    lines = list(islice(file, min(count, _left(file))))
    if len(lines) < count:
        raise _truncated(path, len(lines), count)
    within(path, "the millions of points", count, "points", 1e6)
    names = kind.names or ()
    if not count:
        return np.empty(0, kind)
    try:
        numbers = np.loadtxt(lines, np.float64, comments=None, ndmin=2, encoding="ascii")
        if numbers.shape != (count, len(names)):
            raise ValueError(f"{numbers.shape[0]} rows of {numbers.shape[1]}")
        table = np.empty(count, kind)
        for i, name in enumerate(names):
            with np.errstate(over="ignore", invalid="ignore"):
                table[name] = numbers[:, i]
            if kind[name].kind in "iu" and (table[name] != numbers[:, i]).any():
                raise ValueError(f"{name} beyond its type {kind[name]}")
    except ValueError as error:
        raise ValueError(
            f"{path}: the PLY data must be {count} rows of {len(names)} numbers, got other text "
            f"({error})."
        ) from None
    return table


def _left(file: BinaryIO) -> int:
    """Bytes from the current position to the end."""
    here = file.tell()
    left = max(file.seek(0, 2) - here, 0)
    file.seek(here)
    return left


def _truncated(path: Path, got: int, count: int) -> ValueError:
    return ValueError(
        f"{path}: the PLY data must hold the {count} rows of the header, got {got}; the file is "
        "truncated. Copy it again."
    )
