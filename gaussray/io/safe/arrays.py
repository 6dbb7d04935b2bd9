"""Reads untrusted .npy and .npz files: no pickles, no memory beyond what the file holds."""

import functools
import io
import math
import os
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from gaussray.io.safe.files import opened
from gaussray.io.safe.limits import within


# Largest header in bytes; NumPy writes a few hundred.
_HEADER = 10_000
# Bytes read at a time.
_BLOCK = 1 << 24
# Errors of zipfile for files that are no archive, unknown methods, names that are not text.
_BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, UnicodeDecodeError)
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


class Damaged(ValueError):
    """The file is truncated, or is no .npy or .npz file of plain arrays."""


def read_npz(path: Path | str) -> dict[str, np.ndarray]:
    """The arrays of an .npz file by name.

    Before memory is allocated, sizes in headers are compared with those of the entries, and these
    with limits.arrays.

    Raises:
        Damaged: the file is truncated, no .npz file, or holds Python objects.
        ValueError: the arrays exceed limits.arrays.
        OSError: the file is missing or no regular file.
    """
    try:
        with opened(path) as file, zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            if len({entry.filename for entry in entries}) < len(entries):
                raise Damaged(f"{path}: two arrays have one name. Save it again with numpy.savez.")
            total = sum(entry.file_size for entry in entries)
            within(path, "the arrays in GB", total, "arrays", 1e9)
            return {
                entry.filename.removesuffix(".npy"): _entry(path, archive, entry)
                for entry in entries
            }
    except _BROKEN as error:
        raise Damaged(f"{path}: {str(error)[:200]}") from error
    except FileNotFoundError:
        raise
    # Errors of zipfile for entries that are encrypted or outside the file.
    except (RuntimeError, OverflowError, OSError) as error:
        raise Damaged(f"{path}: {str(error)[:200]}") from error


def read_npy(path: Path | str) -> np.ndarray:
    """The array of an .npy file, with the errors of `read_npz`."""
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        within(path, "the array in GB", size, "arrays", 1e9)
        return _array(path, file, size)


def _entry(path: Path | str, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    if entry.compress_type not in _METHODS:
        raise Damaged(
            f"{path}: '{entry.filename:.80}' is packed by another method than deflate. Save it "
            "again with numpy.savez_compressed."
        )
    with archive.open(entry) as file:
        return _array(f"{path}: '{entry.filename:.80}'", file, entry.file_size)  # type: ignore[arg-type]


def _array(where: object, file: io.BufferedIOBase, size: int) -> np.ndarray:
    """The array of an .npy file of `size` bytes."""
    try:
        version = npy.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"version {version}")
        length = file.read(2 if version == (1, 0) else 4)
        # Whatever length the file claims, no more is read than a header may have.
        header = length + file.read(min(int.from_bytes(length, "little"), _HEADER + 1))
        shape, fortran, kind = _header(version, header)
        if kind.hasobject or kind.subdtype is not None or kind.names or not kind.itemsize:
            raise ValueError(f"numbers of the kind {kind}")
        if kind.kind in "fiu" and kind.itemsize > 8:
            raise ValueError(f"numbers of {kind.itemsize} bytes")
        needed, present = math.prod(shape) * kind.itemsize, size - file.tell()
        if min(shape, default=0) < 0 or len(shape) > 32 or needed != present:
            raise ValueError(f"{present} bytes for the shape {shape}")
        flat = _read_into(np.empty(needed, np.uint8), file).view(kind)
        # JAX requires the byte order of the machine.
        flat = flat.astype(kind.newbyteorder("="), copy=False)
        # Python fails with an internal error on texts with such code points.
        if kind.kind == "U" and flat.view(np.uint32).max(initial=0) > sys.maxunicode:
            raise ValueError("a text with numbers that are no characters")
        return flat.reshape(shape[::-1]).T if fortran else flat.reshape(shape)
    except (zipfile.BadZipFile, zlib.error):
        raise
    # A malformed header raises ValueError, OverflowError, TypeError, SyntaxError and others.
    except Exception as error:
        raise Damaged(f"{where}: no array of NumPy: {' '.join(str(error).split())[:200]}") from None


@functools.lru_cache(maxsize=256)
def _header(version: tuple[int, int], header: bytes) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, order and dtype of a header; cached, because a file has many equal headers."""
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    return read(io.BytesIO(header), max_header_size=_HEADER)


def _read_into(room: np.ndarray, file: io.BufferedIOBase) -> np.ndarray:
    """Fill an array of bytes from a file."""
    at = 0
    while at < len(room):
        block = file.read(min(len(room) - at, _BLOCK))
        if not block:
            raise ValueError(f"it ends after {at} of {len(room)} bytes")
        room[at : at + len(block)] = np.frombuffer(block, np.uint8)
        at += len(block)
    return room
