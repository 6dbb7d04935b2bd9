"""Reads compressed PLY files (PlayCanvas, SuperSplat): a Gaussian is four words of 32 bits.

Element `chunk` has a row for every 256 Gaussians: the least and largest position, logarithm of the
scale and, in newer files, colour. Element `vertex` has, from the highest bits down, packed_position
and packed_scale (11, 10 and 11 bits between the bounds of the chunk), packed_rotation (two bits for
the largest of w x y z, ten for each other, -sqrt(1/2) to sqrt(1/2)) and packed_color (eight bits
each of red, green, blue between the bounds, and opacity). The optional element `sh` has the other
harmonics as bytes, channel-major as f_rest of a PLY file, -4 to 4.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.io.ply import element_names, read_elements
from gaussray.scene.formats.gaussian_ply import RESTS
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0


CHUNK = 256
_WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_HALF = np.sqrt(0.5)


def is_compressed_ply(path: Path | str) -> bool:
    """Whether a PLY file has the packed words of a compressed one."""
    return "packed_position" in element_names(path).get("vertex", ())


def read_compressed_ply(path: Path | str) -> Gaussians:
    """The Gaussians of a compressed PLY file.

    Raises:
        ValueError: The file lacks a column, its chunks are not of 256 Gaussians, or it is cut off.
        FileNotFoundError: The file does not exist.
    """
    tables = read_elements(path, ("chunk", "vertex", "sh"))
    chunk, vertex = tables.get("chunk"), tables["vertex"]
    if chunk is None or not len(vertex) or len(chunk) != -(-len(vertex) // CHUNK):
        raise ValueError(
            f"{path}: a compressed PLY file must have a row of the element chunk for every {CHUNK} "
            "Gaussians, and at least one Gaussian. Export it again."
        )
    _require_columns(path, vertex, _WORDS, "u4")
    chunk_index = np.arange(len(vertex)) // CHUNK
    place, turn, size, color = (vertex[name].astype(np.uint32) for name in _WORDS)
    mean = _between(path, chunk, ("x", "y", "z"), chunk_index, _unpack_three(place))
    log_scale = _between(
        path, chunk, ("scale_x", "scale_y", "scale_z"), chunk_index, _unpack_three(size)
    )
    levels = np.stack([color >> shift & 255 for shift in (24, 16, 8, 0)], axis=1) / 255
    rgb = levels[:, :3]
    if "min_r" in (chunk.dtype.names or ()):
        rgb = _between(path, chunk, ("r", "g", "b"), chunk_index, rgb)
    first = ((rgb - 0.5) / C0)[:, None]
    rest = _higher_harmonics(path, tables.get("sh"), len(vertex))
    values = (
        *(mean, _quaternions(turn), np.exp(log_scale)),
        # A level of 0 or 255 stands for half a step inside: opacities are neither 0 nor 1.
        np.clip(levels[:, 3], 0.5 / 255, 1 - 0.5 / 255),
        np.concatenate([first, rest], axis=1),
    )
    with np.errstate(over="ignore"):
        values = tuple(x.astype(np.float32) for x in values)
    if not all(np.isfinite(x).all() for x in values):
        raise ValueError(
            f"{path}: the bounds of all chunks must be finite, scales in single precision. Export "
            "the file again."
        )
    return Gaussians(*(jnp.asarray(value, jnp.float32) for value in values))


def _require_columns(
    path: Path | str, table: np.ndarray, names: tuple[str, ...], kind: str
) -> None:
    """Raise a ValueError unless the table has these columns, of this type."""
    dtype = table.dtype
    for name in names:
        if name not in (dtype.names or ()) or dtype[name].newbyteorder("=") != np.dtype(kind):
            raise ValueError(
                f"{path}: a compressed PLY file must have the property {name} as {np.dtype(kind)}. "
                "Export it again."
            )


def _unpack_three(word: np.ndarray) -> Float[np.ndarray, "gaussians 3"]:
    """Shares of 11, 10 and 11 bits."""
    parts = (word >> 21 & 2047, word >> 11 & 1023, word & 2047)
    return np.stack(parts, axis=1) / [2047, 1023, 2047]


def _between(
    path: Path | str,
    chunk: np.ndarray,
    names: tuple[str, ...],
    chunk_index: np.ndarray,
    share: Float[np.ndarray, "gaussians 3"],
) -> Float[np.ndarray, "gaussians 3"]:
    """Values at these shares between the bounds of each Gaussian's chunk."""
    bounds = []
    for end in ("min", "max"):
        columns = tuple(f"{end}_{name}" for name in names)
        _require_columns(path, chunk, columns, "f4")
        bounds.append(
            np.stack([chunk[name][chunk_index] for name in columns], axis=1).astype(np.float64)
        )
    return bounds[0] * (1 - share) + bounds[1] * share


def _quaternions(word: np.ndarray) -> Float[np.ndarray, "gaussians 4"]:
    """Unit quaternions w x y z; the largest component is positive."""
    largest = (word >> 30).astype(int)
    three = np.stack([word >> shift & 1023 for shift in (20, 10, 0)], axis=1)
    return smallest_three(largest, (three / 1023 * 2 - 1) * _HALF)


def smallest_three(
    largest: np.ndarray, three: Float[np.ndarray, "gaussians 3"]
) -> Float[np.ndarray, "gaussians 4"]:
    """Unit quaternions of which three components are given.

    Args:
        largest: index of the missing component, the largest.
        three: the other components, in order.
    """
    quat, rows = np.empty((len(three), 4)), np.arange(len(three))
    # The places of the others: 0 1 2 without the largest, shifted behind it.
    for k in range(3):
        quat[rows, k + (k >= largest)] = three[:, k]
    quat[rows, largest] = np.sqrt(np.maximum(1 - (three**2).sum(axis=1), 0))
    # Three levels at their ends are longer than 1.
    return quat / np.linalg.norm(quat, axis=1, keepdims=True)


def _higher_harmonics(
    path: Path | str, table: np.ndarray | None, count: int
) -> Float[np.ndarray, "gaussians rest 3"]:
    """The harmonics above the constant one."""
    if table is None:
        return np.zeros((count, 0, 3))
    names = tuple(f"f_rest_{i}" for i in range(len(table.dtype.names or ())))
    if len(names) not in RESTS or len(table) != count:
        raise ValueError(
            f"{path}: the element sh must hold 9, 24 or 45 numbers for each of {count} Gaussians, "
            f"got {len(names)} for each of {len(table)}. Export it again."
        )
    _require_columns(path, table, names, "u1")
    level = np.stack([table[name] for name in names], axis=1).astype(np.float64)
    # The outermost levels are the ends of the range, the others the middles of 256 equal parts.
    share = np.where(level == 0, 0, np.where(level == 255, 1, (level + 0.5) / 256))
    return (8 * share - 4).reshape(count, 3, len(names) // 3).swapaxes(1, 2)
