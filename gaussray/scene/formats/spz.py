"""Reads and writes SPZ files (Niantic): a header and columns of bytes.

Versions 2 and 3 are packed by gzip as a whole or not at all, version 4 column by column by
Zstandard.

Header, little endian: magic "NGSP", version, number of Gaussians (uint32 each), degree of the
harmonics, fractional bits of positions, flags, and a zero; of version 4 the number of columns, and
after it the place of the table of their packed and unpacked lengths (uint32) and twelve zeros.
Columns: positions of three times 24 bits; opacities; colours 0.15 c + 0.5; scales 16 (log s + 10);
rotations; harmonics 128 c + 128, the three channels of a coefficient together. Axes are right, up,
back, against right, down, forward of PLY files: y and z change sign.
"""

import gzip
import warnings
import zlib
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from gaussray.io.atomic import atomic_path
from gaussray.io.safe.files import opened, read_binary
from gaussray.io.safe.limits import within
from gaussray.scene.gaussians import Gaussians


MAGIC = b"NGSP"
_HEADER = np.dtype(
    [("magic", "S4"), ("version", "<u4"), ("count", "<u4")]
    + [(name, "u1") for name in ("degree", "bits", "flags", "streams")]
)
_COLUMNS = ("position", "opacity", "color", "scale", "rotation", "harmonics")
# Of version 4: bytes of the header, the flag of extensions, and the extension that names axes.
_LONG_HEADER, _EXTENDED, _AXES = 32, 2, 0xADBE0003
_BITS, _COLOR = 12, 0.15
_HALF = np.sqrt(0.5)
# y and z change sign between both systems of axes; so do the harmonics that are odd in y and z.
_FLIP = np.array([1, -1, -1], np.float32)
_ODD = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)


def read_spz(path: Path | str) -> Gaussians:
    """The Gaussians of an SPZ file.

    Raises:
        ValueError: The file is no SPZ of version 2 to 4, or is cut off; or it is of version 4 and
            the package zstandard is not installed.
        FileNotFoundError: The file does not exist.
    """
    with opened(path) as file:
        plain = file.read(4) == MAGIC
    data = read_binary(path) if plain else _gunzip(path)
    if len(data) < _HEADER.itemsize or data[:4] != MAGIC:
        raise ValueError(f"{path}: must be an SPZ file (magic NGSP), got {data[:4]!r}.")
    head = np.frombuffer(data, _HEADER, 1)[0]
    version, count, degree = int(head["version"]), int(head["count"]), int(head["degree"])
    versions = (2, 3, 4) if plain else (2, 3)
    if version not in versions or degree > 3:
        raise ValueError(
            f"{path}: must be SPZ of version 2, 3 or 4 and degree 0 to 3, got version {version} "
            f"and degree {degree}. Export it again for version 3."
        )
    within(path, "the millions of Gaussians", count, "points", 1e6)
    rest = (degree + 1) ** 2 - 1
    sizes = [count * width for width in (9, 1, 3, 3, 3 if version == 2 else 4, 3 * rest)]
    parts = (
        _streams(path, data, sizes)
        if version == 4
        else _split_columns(data[_HEADER.itemsize :], sizes)
    )
    if not count or [len(part) for part in parts] != sizes:
        raise ValueError(
            f"{path}: must hold {count} Gaussians, at least one; it is cut off, or more follows."
        )
    columns = [np.frombuffer(part, np.uint8).reshape(count, len(part) // count) for part in parts]
    return _gaussians(columns, int(head["bits"]), version, rest)


def _split_columns(data: bytes, sizes: Sequence[int]) -> list[bytes]:
    """Parts of these sizes, and what is left over if there is more."""
    ends = np.cumsum(sizes).tolist()
    parts = [data[end - size : end] for size, end in zip(sizes, ends, strict=True)]
    return [*parts, data[ends[-1] :]] if len(data) > ends[-1] else parts


def _streams(path: Path | str, data: bytes, sizes: Sequence[int]) -> list[bytes]:
    """The columns of version 4, unpacked."""
    head = np.frombuffer(data, _HEADER, 1)[0]
    count, begin = int(head["streams"]), int.from_bytes(data[16:20], "little")
    # The column of harmonics may be left out where there are none.
    sizes = sizes if count == len(sizes) else [size for size in sizes if size]
    table = begin + 16 * count
    if count != len(sizes) or begin < _LONG_HEADER or len(data) < table:
        raise ValueError(f"{path}: must hold {len(sizes)} columns, got {count}; or it is cut off.")
    _refuse_axes(path, data[_LONG_HEADER:begin] if head["flags"] & _EXTENDED else b"")
    unpacker, parts = zstandard_module().ZstdDecompressor(), []
    for size, (packed, full) in zip(
        sizes, np.frombuffer(data, "<u8", 2 * count, begin).reshape(-1, 2).tolist(), strict=True
    ):
        part = data[table : table + packed]
        if full != size or len(part) != packed:
            raise ValueError(
                f"{path}: a column must have {size} bytes, got {full}; or it is cut off."
            )
        try:
            parts.append(unpacker.decompress(part, max_output_size=size) if size else b"")
        except Exception as error:
            raise ValueError(f"{path}: a column is damaged ({error}). Copy it again.") from None
        table += packed
    return parts + [b""] * (len(_COLUMNS) - len(parts))


def _refuse_axes(path: Path | str, records: bytes) -> None:
    """Raise a ValueError if an extension says that axes are others."""
    while len(records) >= 8:
        kind, length = (int.from_bytes(records[i : i + 4], "little") for i in (0, 4))
        if kind == _AXES:
            raise ValueError(
                f"{path}: must have the axes of SPZ (right, up, back), got an extension with "
                "others. Export it without SPZ_ADOBE_coordinate_system."
            )
        records = records[8 + length :]


def zstandard_module() -> Any:
    """The package that packs SPZ of version 4.

    Raises:
        ValueError: It is not installed.
    """
    try:
        return import_module("zstandard")
    except ImportError:
        raise ValueError(
            "SPZ of version 4 needs the package zstandard: pip install -e '.[spz]', or use "
            "version 3."
        ) from None


def write_spz(path: Path | str, gaussians: Gaussians, version: int = 3) -> None:
    """Write Gaussians at one time, without tints, as SPZ of version 3 or 4.

    Positions are kept to 2^-12 of a unit, scales to 3 %, colours and opacities to a 255th.

    Args:
        path: the file.
        gaussians: the Gaussians.
        version: 3 (gzip) or 4 (Zstandard).

    Raises:
        ValueError: A position lies beyond 2048 units, for which the format has no room; or the
            package zstandard is not installed, for version 4.
    """
    mean = np.asarray(gaussians.mean, np.float64) * _FLIP
    if np.abs(mean).max(initial=0) >= 2**11:
        raise ValueError(
            f"{path}: positions in SPZ must lie within 2048 units of the origin, got "
            f"{np.abs(mean).max():.6g}. Scale the scene."
        )
    harmonics = np.asarray(gaussians.harmonics, np.float64)
    rest = harmonics.shape[1] - 1
    fixed = np.round(mean * 2**_BITS).astype(np.int32)
    parts = [
        np.stack([(fixed >> shift) & 255 for shift in (0, 8, 16)], axis=-1).reshape(len(mean), 9),
        255 * np.asarray(gaussians.opacity)[:, None],
        255 * (harmonics[:, 0] * _COLOR + 0.5),
        16 * (np.log(np.asarray(gaussians.scale)) + 10),
        _pack_quaternions(np.asarray(gaussians.quat, np.float64)),
        128 * (harmonics[:, 1:] * _ODD[:rest, None]).reshape(len(mean), 3 * rest) + 128,
    ]
    _warn_of_range(path, parts)
    levels = [np.clip(np.round(p), 0, 255).astype(np.uint8).tobytes() for p in parts]
    degree = round(np.sqrt(rest + 1)) - 1
    streams = len(_COLUMNS) if version == 4 else 0
    head = np.array([(MAGIC, version, len(mean), degree, _BITS, 0, streams)], _HEADER).tobytes()
    if version == 3:
        content = gzip.compress(head + b"".join(levels), mtime=0)
    else:
        packer = zstandard_module().ZstdCompressor(level=12)
        packed = [packer.compress(level) for level in levels]
        table = [[len(a), len(b)] for a, b in zip(packed, levels, strict=True)]
        long = head + _LONG_HEADER.to_bytes(4, "little") + bytes(12)
        content = long + np.array(table, "<u8").tobytes() + b"".join(packed)
    with atomic_path(path) as partial:
        partial.write_bytes(content)


def _warn_of_range(path: Path | str, parts: Sequence[np.ndarray]) -> None:
    """Warn of numbers for which the format has no room."""
    names = {2: "colours (-0.44 to 1.44)", 3: "scales (4.5e-5 to 380)", 5: "harmonics (-1 to 1)"}
    beyond = {
        name: np.mean(np.any((parts[i] < -0.5) | (parts[i] > 255.5), axis=1))
        for i, name in names.items()
        if parts[i].size
    }
    losses = [
        f"{name} of {100 * share:.3g} % of the Gaussians" for name, share in beyond.items() if share
    ]
    if losses:
        warnings.warn(
            f"{path}: SPZ has no room for {' and '.join(losses)}: they are cut to what it can "
            "hold. Use PLY where they matter.",
            stacklevel=3,
        )


def _gunzip(path: Path | str) -> bytes:
    """The bytes of a gzip file, of at most limits.arrays."""
    packed, unpacker = read_binary(path), zlib.decompressobj(wbits=31)
    try:
        size = min(len(packed) * 1032 + 64, 1 << 62)
        data = unpacker.decompress(packed, size)
    except zlib.error as error:
        raise ValueError(f"{path}: must be SPZ packed by gzip, got {error}.") from None
    within(path, "the arrays in GB", len(data), "arrays", 1e9)
    if not unpacker.eof:
        raise ValueError(f"{path}: the SPZ file is cut off. Copy it again.")
    return data


def _gaussians(columns: list[np.ndarray], bits: int, version: int, rest: int) -> Gaussians:
    position, alpha, color, size, turn, others = columns
    parts = position.reshape(-1, 3, 3).astype(np.int32)
    fixed = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    mean = np.where(fixed >= 1 << 23, fixed - (1 << 24), fixed) / 2.0**bits * _FLIP
    quat = _three_component_quaternions(turn) if version == 2 else _unpack_quaternions(turn)
    first = ((color / 255.0 - 0.5) / _COLOR)[:, None]
    more = (others.reshape(len(others), rest, 3).astype(np.float64) - 128) / 128 * _ODD[:rest, None]
    values = (
        *(mean, quat, np.exp(size / 16.0 - 10)),
        np.clip(alpha[:, 0] / 255.0, 0.5 / 255, 1 - 0.5 / 255),
        np.concatenate([first, more], axis=1),
    )
    return Gaussians(*(jnp.asarray(value, jnp.float32) for value in values))


def _three_component_quaternions(levels: np.ndarray) -> np.ndarray:
    """Quaternions wxyz in PLY axes of version 2: x y z as bytes, w not negative."""
    xyz = (levels / 127.5 - 1) * _FLIP
    w = np.sqrt(np.maximum(1 - (xyz**2).sum(axis=1, keepdims=True), 0))
    return np.concatenate([w, xyz], axis=1)


def _unpack_quaternions(levels: np.ndarray) -> np.ndarray:
    """Quaternions wxyz in PLY axes of version 3: the index of the largest of x y z w in two bits,
    then the others, each a sign and nine bits in steps of sqrt(1/2) / 511."""
    word = np.ascontiguousarray(levels).view("<u4")[:, 0].astype(np.int64)
    largest, quat = word >> 30, np.zeros((len(word), 4))
    for i in (3, 2, 1, 0):
        here = largest != i
        value = _HALF * (word & 511) / 511 * np.where(word & 512, -1, 1)
        quat[here, i] = value[here]
        word = np.where(here, word >> 10, word)
    rows = np.arange(len(word))
    quat[rows, largest] = np.sqrt(np.maximum(1 - (quat**2).sum(axis=1), 0))
    quat[:, :3] *= _FLIP
    return quat[:, [3, 0, 1, 2]]


def _pack_quaternions(quat: np.ndarray) -> np.ndarray:
    """The bytes that `_unpack_quaternions` reads."""
    unit = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    xyzw = unit[:, [1, 2, 3, 0]] * np.append(_FLIP, 1)
    largest, rows = np.abs(xyzw).argmax(axis=1), np.arange(len(quat))
    xyzw = xyzw * np.where(xyzw[rows, largest] < 0, -1, 1)[:, None]
    word = largest.astype(np.int64)
    for i in range(4):
        level = np.minimum(np.abs(xyzw[:, i]) / _HALF * 511 + 0.5, 511).astype(np.int64)
        part = level | np.where(xyzw[:, i] < 0, 512, 0)
        word = np.where(largest != i, word << 10 | part, word)
    return word.astype("<u4")[:, None].view(np.uint8)
