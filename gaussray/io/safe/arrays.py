"""NumPy's files of arrays, read without trust: no pickle, no promise that the file breaks."""

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


# Bytes of a header, of which NumPy's own take a few hundred.
_HEADER = 10_000
# Bytes read at a time.
_BLOCK = 1 << 24
# What zipfile says of one that is none, of a kind it does not know, of names that are no text.
_BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, UnicodeDecodeError)
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


class Damaged(ValueError):
    """A file that is no file of arrays, or not a whole one."""


def read_npz(path: Path | str) -> dict[str, np.ndarray]:
    """The arrays of an .npz file by name.

    Sizes in headers are held against those of the entries, and these against limits.arrays, before
    memory is taken. Damaged if it is none, or is cut off, or holds objects.
    """
    try:
        with opened(path) as file, zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            if len({entry.filename for entry in entries}) < len(entries):
                raise Damaged(f"{path}: two arrays have one name.")
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
    # What zipfile says of entries that are encrypted, or that lie nowhere.
    except (RuntimeError, OverflowError, OSError) as error:
        raise Damaged(f"{path}: {str(error)[:200]}") from error


def read_npy(path: Path | str) -> np.ndarray:
    """The array of an .npy file; Damaged if it is none."""
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        within(path, "the array in GB", size, "arrays", 1e9)
        return _array(path, file, size)


def _entry(path: Path | str, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    if entry.compress_type not in _METHODS:
        raise Damaged(f"{path}: '{entry.filename:.80}' is packed by another method than deflate.")
    with archive.open(entry) as file:
        return _array(f"{path}: '{entry.filename:.80}'", file, entry.file_size)  # type: ignore[arg-type]


def _array(where: object, file: io.BufferedIOBase, size: int) -> np.ndarray:
    """The array in a file of so many bytes."""
    try:
        version = npy.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"version {version}")
        digits = file.read(2 if version == (1, 0) else 4)
        # Whatever it says, no more is read than a header may have.
        told = digits + file.read(min(int.from_bytes(digits, "little"), _HEADER + 1))
        shape, fortran, kind = _header(version, told)
        if kind.hasobject or kind.subdtype is not None or kind.names or not kind.itemsize:
            raise ValueError(f"numbers of the kind {kind}")
        if kind.kind in "fiu" and kind.itemsize > 8:
            raise ValueError(f"numbers of {kind.itemsize} bytes")
        wanted, held = math.prod(shape) * kind.itemsize, size - file.tell()
        if min(shape, default=0) < 0 or len(shape) > 32 or wanted != held:
            raise ValueError(f"{held} bytes for the shape {shape}")
        flat = _filled(np.empty(wanted, np.uint8), file).view(kind)
        # Of the machine's own byte order, as JAX demands.
        flat = flat.astype(kind.newbyteorder("="), copy=False)
        # NumPy would make texts of them that Python itself takes for its own error.
        if kind.kind == "U" and flat.view(np.uint32).max(initial=0) > sys.maxunicode:
            raise ValueError("a text with numbers that are no characters")
        return flat.reshape(shape[::-1]).T if fortran else flat.reshape(shape)
    except (zipfile.BadZipFile, zlib.error):
        raise
    # A malformed header raises ValueError, OverflowError, TypeError, SyntaxError and others.
    except Exception as error:
        raise Damaged(f"{where}: no array of NumPy: {' '.join(str(error).split())[:200]}") from None


@functools.lru_cache(maxsize=256)
def _header(version: tuple[int, int], told: bytes) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, order and kind in a header, kept, for a file has many that are alike."""
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    return read(io.BytesIO(told), max_header_size=_HEADER)


def _filled(room: np.ndarray, file: io.BufferedIOBase) -> np.ndarray:
    """All of the bytes of an array from a file."""
    at = 0
    while at < len(room):
        block = file.read(min(len(room) - at, _BLOCK))
        if not block:
            raise ValueError(f"it ends after {at} of {len(room)} bytes")
        room[at : at + len(block)] = np.frombuffer(block, np.uint8)
        at += len(block)
    return room
