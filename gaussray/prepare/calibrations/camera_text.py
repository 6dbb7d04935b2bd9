"""Text files of camera matrices: KRT files (Neural Volumes, Multiface), and projections K [R | t].

A block of a camera is a line with its name, perhaps K (three lines of 3 numbers) and a line of
distortion, and a matrix (three lines of 4 numbers): [R | t] behind K, and else the projection. That
may be one line of 12 numbers as well, or of the 11 coefficients of a direct linear transform (DLT),
whose twelfth is 1. A file of 11 lines has such coefficients of a camera in each column (DLTdv,
Argus).
"""

from pathlib import Path
from typing import Any

import numpy as np

from gaussray.io.safe.files import read_text
from gaussray.prepare.errors import PrepareError


_LARGEST = 1_000_000
# What may stand before the one matrix of a file, and is no name (Furukawa and Ponce's data sets).
_HEADERS = ("contour",)
TEXT_RECIPE = (
    "A camera has a line with its name, three lines of K, one of distortion (k1 k2 p1 p2 k3) and "
    "three of [R | t] from world to camera; or three lines of a 3 x 4 projection alone, or its 12 "
    "numbers (11 of a DLT) in one line."
)
# Coefficients of a direct linear transform: a projection's numbers but the last, which is 1.
_DLT = 11
_Lines = list[tuple[int, list[str]]]


def is_camera_text(path: Path) -> bool:
    """Whether a text file is called as one of camera matrices (KRT), or begins like one (.txt,
    .csv)."""
    name = path.name.lower()
    suffix = path.suffix.lower()
    if suffix not in ("", ".krt", ".txt", ".csv") or name.endswith(".qca.txt"):
        return False
    if (not suffix and not name.startswith("krt")) or not path.is_file():
        return False
    if name.startswith("krt") or suffix == ".krt":
        return True
    if path.stat().st_size > _LARGEST:
        return False
    try:
        lines = _lines(path)
    except (OSError, ValueError):
        return False
    if _are_columns(lines):
        return True
    start = 0 if _starts(lines, 0) else 1
    return _starts(lines, start)


def text_cameras(path: Path) -> dict[str, dict[str, Any]]:
    """The values of each camera of a file by its name; by its number from 0 where it has none.

    Args:
        path: the file (`is_camera_text`).

    Raises:
        PrepareError: There is no block, one is incomplete, or a name is there twice.
    """
    lines = _lines(path)
    if _are_columns(lines):
        columns = _matrix(lines, 0, _DLT).T
        return {str(k): {"P": np.append(column, 1.0)} for k, column in enumerate(columns)}
    if not lines:
        raise PrepareError(f"{path}: must hold the numbers of a camera, got no line. {TEXT_RECIPE}")
    result: dict[str, dict[str, Any]] = {}
    place, unnamed = 0, 0
    while place < len(lines):
        name = str(len(result))
        if not _starts(lines, place):
            name = " ".join(lines[place][1])
            place += 1
        else:
            unnamed += 1
        values, count = _block(path, lines, place)
        if name in result:
            raise PrepareError(
                f"{path}: each camera must have a name of its own, got {name[:80]} twice. Change "
                "one."
            )
        result[name] = values
        place += count
    if unnamed not in (0, len(result)):
        raise PrepareError(
            f"{path}: each camera must have a line with its name, or none of them, got "
            f"{', '.join(result)[:200]}. Add the names."
        )
    return result


def text_camera(path: Path) -> dict[str, Any] | None:
    """The values of the one camera of a file; None if it has several, or a name of its own.

    Args:
        path: the file (`is_camera_text`).

    Raises:
        PrepareError: There is no block, or one is incomplete.
    """
    ((name, values), *others) = text_cameras(path).items()
    return None if others or name.lower() not in ("0", *_HEADERS) else values


def has_columns(path: Path) -> bool:
    """Whether a file has the coefficients of a camera in each of several columns; the order of the
    columns is that of the cameras."""
    lines = _lines(path)
    return _are_columns(lines) and len(lines[0][1]) > 1


def _are_columns(lines: _Lines) -> bool:
    """Whether lines are the 11 coefficients of a camera in each column."""
    width = len(lines[0][1]) if lines else 0
    # As many numbers in a line may be a camera's.
    return len(lines) == _DLT and width < _DLT and _are(lines, 0, _DLT, width)


def _block(path: Path, lines: _Lines, place: int) -> tuple[dict[str, Any], int]:
    """The values of a block of numbers, and how many lines it has."""
    if _is_flat(lines, place):
        numbers = _matrix(lines, place, 1)[0]
        return {"P": np.append(numbers, 1.0) if len(numbers) == _DLT else numbers}, 1
    start = place
    values: dict[str, Any] = {}
    if _are(lines, place, 3, 3):
        values["K"] = _matrix(lines, place, 3)
        place += 3
        # A line of distortion may have four numbers as well.
        whole = _are(lines, place, 4, 4) and _is_last_row(lines, place + 3)
        if not _are(lines, place, 3, 4) or (_are(lines, place, 4, 4) and not whole):
            if place < len(lines) and _numbers(lines[place][1]) is not None:
                values["dist"] = _numbers(lines[place][1])
                place += 1
    if not _are(lines, place, 3, 4):
        number, words = lines[place] if place < len(lines) else (None, [])
        where = "the end of the file" if number is None else f"line {number}"
        rule = "three lines of 4 numbers" if "K" in values else "three lines of 3 or of 4 numbers"
        raise PrepareError(
            f"{path}: {where} must be the first of {rule}, got "
            f"{' '.join(words)[:80] or 'nothing'}. {TEXT_RECIPE}"
        )
    values["[R | t]" if "K" in values else "P"] = _matrix(lines, place, 3)
    place += 3
    return values, place + _is_last_row(lines, place) - start


def _is_last_row(lines: _Lines, place: int) -> bool:
    """Whether a line is the row 0 0 0 1 of a 4 x 4 matrix."""
    if not _are(lines, place, 1, 4):
        return False
    return bool(np.abs(_matrix(lines, place, 1) - (0, 0, 0, 1)).max() <= 1e-6)


def _starts(lines: _Lines, place: int) -> bool:
    """Whether numbers of a block begin at a line."""
    return _is_flat(lines, place) or _are(lines, place, 3, 3) or _are(lines, place, 3, 4)


def _is_flat(lines: _Lines, place: int) -> bool:
    """Whether a line is a whole projection, or the coefficients of a DLT."""
    return _are(lines, place, 1, 12) or _are(lines, place, 1, _DLT)


def _are(lines: _Lines, place: int, count: int, width: int) -> bool:
    """Whether so many lines from a place on have so many numbers each."""
    part = [words for _, words in lines[place : place + count]]
    return len(part) == count and all(
        len(words) == width and _numbers(words) is not None for words in part
    )


def _matrix(lines: _Lines, place: int, count: int) -> np.ndarray:
    return np.array([_numbers(words) for _, words in lines[place : place + count]])


def _numbers(words: list[str]) -> list[float] | None:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return None
    return numbers if np.isfinite(numbers).all() else None


def _lines(path: Path) -> _Lines:
    """The lines that are not empty, with their numbers, in words; commas and brackets are gaps."""
    text = read_text(path).decode("utf-8-sig", "replace").translate(str.maketrans(",;[]", "    "))
    lines = ((number, line.split()) for number, line in enumerate(text.splitlines(), 1))
    return [(number, words) for number, words in lines if words]
