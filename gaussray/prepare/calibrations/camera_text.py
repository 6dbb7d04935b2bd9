"""Text files of camera matrices: KRT files (Neural Volumes, Multiface), and projections K [R | t].

A block of a camera is a line with its name, perhaps K (three lines of 3 numbers) and a line of
distortion, and a matrix (three lines of 4 numbers): [R | t] behind K, and else the projection. That
may be one line of 12 numbers as well, or of the 11 coefficients of a direct linear transform (DLT),
whose twelfth is 1; the name may stand before them in their line. A file of 11 lines, below names
perhaps, has such coefficients of a camera in each column (DLTdv, Argus).
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gaussray.prepare.calibrations.dlt_columns import (
    DLT_COUNT,
    FLAT_COUNTS,
    dlt_columns,
    names_apart,
    refuse_square_table,
)
from gaussray.prepare.calibrations.known_camera import check_distinct_names
from gaussray.prepare.calibrations.projections import dlt_projection
from gaussray.prepare.calibrations.text_lines import NumberedLines, line_numbers, numbered_lines
from gaussray.prepare.calibrations.value_names import DLT_KEY
from gaussray.prepare.errors import PrepareError


_LARGEST = 1_000_000
# What may stand before the one matrix of a file, and is no name (Furukawa and Ponce's data sets).
_HEADERS = ("contour",)
TEXT_RECIPE = (
    "A camera has a line with its name, three lines of K, one of distortion (k1 k2 p1 p2 k3) and "
    "three of [R | t] from world to camera; or three lines of a 3 x 4 projection alone, or its 12 "
    "numbers (11 of a DLT) in one line, before which the name may stand (no number, unless a first "
    "line says name,L1,...,L11). 11 lines have a camera of a DLT in each column, below a line of "
    "names that are not all numbers, or none; 11 lines of 11 or 12 numbers need the names."
)


class TextCameras(NamedTuple):
    """The cameras of a text file.

    Args:
        cameras: values of each camera by its name; by its number from 0 where it has none.
        in_order: each of several columns has the coefficients of a camera, without names: the order
            of the columns is that of the cameras.
    """

    cameras: dict[str, dict[str, Any]]
    in_order: bool = False

    @property
    def alone(self) -> dict[str, Any] | None:
        """The values of the one camera; None if there are several, or it has a name of its own."""
        ((name, values), *others) = self.cameras.items()
        return None if others or name.lower() not in ("0", *_HEADERS) else values


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
        lines = numbered_lines(path)
    except (OSError, ValueError):
        return False
    if dlt_columns(lines) is not None:
        return True
    lines = names_apart(lines)
    start = 0 if _starts(lines, 0) else 1
    return _starts(lines, start)


def text_cameras(path: Path) -> TextCameras:
    """The values of each camera of a file.

    Args:
        path: the file (`is_camera_text`).

    Raises:
        PrepareError: There is no block, one is incomplete, a name is there twice, or cameras may be
            in lines or in columns.
    """
    lines = numbered_lines(path)
    columns = dlt_columns(lines)
    if columns is not None:
        names = columns.names or [str(k) for k in range(len(columns.coefficients))]
        check_distinct_names(path, names)
        values = [{DLT_KEY: dlt_projection(numbers)} for numbers in columns.coefficients]
        in_order = columns.names is None and len(names) > 1
        return TextCameras(dict(zip(names, values, strict=True)), in_order)
    refuse_square_table(path, lines)
    lines = names_apart(lines)
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
        check_distinct_names(path, [*result, name])
        result[name] = values
        place += count
    if unnamed not in (0, len(result)):
        raise PrepareError(
            f"{path}: each camera must have a line with its name, or none of them, got "
            f"{', '.join(result)[:200]}. Add the names."
        )
    return TextCameras(result)


def _block(path: Path, lines: NumberedLines, place: int) -> tuple[dict[str, Any], int]:
    """The values of a block of numbers, and how many lines it has."""
    if _is_flat(lines, place):
        numbers = _matrix(lines, place, 1)[0]
        dlt = len(numbers) == DLT_COUNT
        return {DLT_KEY: dlt_projection(numbers)} if dlt else {"P": numbers}, 1
    start = place
    values: dict[str, Any] = {}
    if _are(lines, place, 3, 3):
        values["K"] = _matrix(lines, place, 3)
        place += 3
        # A line of distortion may have four numbers as well.
        whole = _are(lines, place, 4, 4) and _is_last_row(lines, place + 3)
        if not _are(lines, place, 3, 4) or (_are(lines, place, 4, 4) and not whole):
            if place < len(lines) and line_numbers(lines[place][1]) is not None:
                values["dist"] = line_numbers(lines[place][1])
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


def _is_last_row(lines: NumberedLines, place: int) -> bool:
    """Whether a line is the row 0 0 0 1 of a 4 x 4 matrix."""
    if not _are(lines, place, 1, 4):
        return False
    return bool(np.abs(_matrix(lines, place, 1) - (0, 0, 0, 1)).max() <= 1e-6)


def _starts(lines: NumberedLines, place: int) -> bool:
    """Whether numbers of a block begin at a line."""
    return _is_flat(lines, place) or _are(lines, place, 3, 3) or _are(lines, place, 3, 4)


def _is_flat(lines: NumberedLines, place: int) -> bool:
    """Whether a line is a whole projection, or the coefficients of a DLT."""
    return any(_are(lines, place, 1, count) for count in FLAT_COUNTS)


def _are(lines: NumberedLines, place: int, count: int, width: int) -> bool:
    """Whether so many lines from a place on have so many numbers each."""
    part = [words for _, words in lines[place : place + count]]
    return len(part) == count and all(
        len(words) == width and line_numbers(words) is not None for words in part
    )


def _matrix(lines: NumberedLines, place: int, count: int) -> np.ndarray:
    return np.array([line_numbers(words) for _, words in lines[place : place + count]])
