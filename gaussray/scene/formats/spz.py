"""Reads and writes SPZ files (Niantic), versions 2 and 3: gzip of a header and of columns of bytes.

Header, little endian: magic "NGSP", version, number of Gaussians (uint32 each), degree of the
harmonics, fractional bits of positions, flags, a zero (bytes). Columns: positions of three times 24
bits; opacities; colours 0.15 c + 0.5; scales 16 (log s + 10); rotations; harmonics 128 c + 128, the
three channels of a coefficient together. Axes are right, up, back, against right, down, forward of
PLY files: y and z change sign.
"""

import gzip
import zlib
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gaussray.io.atomic import whole
from gaussray.io.safe.files import opened
from gaussray.io.safe.limits import within
from gaussray.scene.gaussians import Gaussians


MAGIC = b"NGSP"
_HEADER = np.dtype(
    [("magic", "S4"), ("version", "<u4"), ("count", "<u4")]
    + [(name, "u1") for name in ("degree", "bits", "flags", "zero")]
)
_BITS, _COLOR = 12, 0.15
_HALF = np.sqrt(0.5)
# y and z change sign between both systems of axes; so do the harmonics that are odd in y and z.
_FLIP = np.array([1, -1, -1], np.float32)
_ODD = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)


def read_spz(path: Path | str) -> Gaussians:
    """The Gaussians of an SPZ file.

    Raises:
        ValueError: The file is no SPZ of version 2 or 3, or is cut off.
        FileNotFoundError: The file does not exist.
    """
    data = _unpacked(path)
    if len(data) < _HEADER.itemsize or data[:4] != MAGIC:
        raise ValueError(f"{path}: must be an SPZ file (magic NGSP), got {data[:4]!r}.")
    head = np.frombuffer(data, _HEADER, 1)[0]
    version, count, degree = int(head["version"]), int(head["count"]), int(head["degree"])
    if version not in (2, 3) or degree > 3:
        raise ValueError(
            f"{path}: must be SPZ of version 2 or 3 and degree 0 to 3, got version {version} and "
            f"degree {degree}. Export it again for version 3."
        )
    rest = (degree + 1) ** 2 - 1
    widths = (9, 1, 3, 3, 3 if version == 2 else 4, 3 * rest)
    if not count or len(data) != _HEADER.itemsize + count * sum(widths):
        raise ValueError(f"{path}: must hold {count} Gaussians, at least one; it is cut off.")
    columns, begin = [], _HEADER.itemsize
    for width in widths:
        columns.append(np.frombuffer(data, np.uint8, count * width, begin).reshape(count, width))
        begin += count * width
    return _gaussians(columns, int(head["bits"]), version, rest)


def write_spz(path: Path | str, gaussians: Gaussians) -> None:
    """Write Gaussians at one time, without tints, as SPZ of version 3.

    Positions are kept to 2^-12 of a unit, scales to 3 %, colours and opacities to a 255th.

    Raises:
        ValueError: A position lies beyond 2048 units, for which the format has no room.
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
        _packed_turns(np.asarray(gaussians.quat, np.float64)),
        128 * (harmonics[:, 1:] * _ODD[:rest, None]).reshape(len(mean), 3 * rest) + 128,
    ]
    levels = [np.clip(np.round(p), 0, 255).astype(np.uint8).tobytes() for p in parts]
    degree = round(np.sqrt(rest + 1)) - 1
    head = np.array([(MAGIC, 3, len(mean), degree, _BITS, 0, 0)], _HEADER)
    with whole(path) as partial:
        partial.write_bytes(gzip.compress(head.tobytes() + b"".join(levels), mtime=0))


def _unpacked(path: Path | str) -> bytes:
    """The bytes of a gzip file, of at most limits.arrays."""
    with opened(path) as file:
        packed, unpacker = file.read(), zlib.decompressobj(wbits=31)
    try:
        size = min(len(packed) * 1032 + 64, 1 << 62)
        within(path, "the file in GB", len(packed), "arrays", 1e9)
        data = unpacker.decompress(packed, size)
    except zlib.error as error:
        raise ValueError(f"{path}: must be SPZ packed by gzip, got {error}.") from None
    within(path, "the arrays in GB", len(data), "arrays", 1e9)
    if not unpacker.eof:
        raise ValueError(f"{path}: the SPZ file is cut off. Copy it again.")
    return data


def _gaussians(columns: list[np.ndarray], bits: int, version: int, rest: int) -> Gaussians:
    place, alpha, color, size, turn, others = columns
    parts = place.reshape(-1, 3, 3).astype(np.int32)
    fixed = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    mean = np.where(fixed >= 1 << 23, fixed - (1 << 24), fixed) / 2.0**bits * _FLIP
    quat = _small_turns(turn) if version == 2 else _smallest_three(turn)
    first = ((color / 255.0 - 0.5) / _COLOR)[:, None]
    more = (others.reshape(len(others), rest, 3).astype(np.float64) - 128) / 128 * _ODD[:rest, None]
    values = (
        *(mean, quat, np.exp(size / 16.0 - 10)),
        np.clip(alpha[:, 0] / 255.0, 0.5 / 255, 1 - 0.5 / 255),
        np.concatenate([first, more], axis=1),
    )
    return Gaussians(*(jnp.asarray(value, jnp.float32) for value in values))


def _small_turns(levels: np.ndarray) -> np.ndarray:
    """Quaternions wxyz in PLY axes of version 2: x y z as bytes, w not negative."""
    xyz = (levels / 127.5 - 1) * _FLIP
    w = np.sqrt(np.maximum(1 - (xyz**2).sum(axis=1, keepdims=True), 0))
    return np.concatenate([w, xyz], axis=1)


def _smallest_three(levels: np.ndarray) -> np.ndarray:
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


def _packed_turns(quat: np.ndarray) -> np.ndarray:
    """The bytes of `_smallest_three`."""
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
