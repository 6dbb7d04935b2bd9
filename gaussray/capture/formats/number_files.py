"""Texts of numbers: a pose or a time on each line, a matrix, the intrinsics of a camera."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gaussray.capture.camera_matrix import SLIGHT_SKEW
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.lenses import INTRINSICS
from gaussray.capture.formats.project_files import head_of
from gaussray.capture.formats.sfm_project import FIRST_PIXEL
from gaussray.capture.formats.transforms import json_object
from gaussray.io.safe.files import read_text
from gaussray.io.safe.limits import within


# The files that tell the lens of a folder's pictures; the first that exists is read.
MATRIX_FILE, COEFFICIENTS_FILE, KEYS_FILE = "camera-intrinsics.txt", "calib.txt", "camera.json"
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
# A comment begins a line or follows a blank: 1.#INF has none.
_COMMENT = re.compile(r"(?:^|\s)#")
# How Microsoft's compilers write what is no number, or infinite.
_NOT_FINITE = re.compile(r"[-+]?(?:1\.#[A-Z]+\d*|nan\(\w*\))", re.IGNORECASE)


def lines_of(text: bytes) -> list[tuple[int, str]]:
    """The lines of a text that are neither blank nor a comment (#), with their numbers from 1.

    Args:
        text: the text, with or without a byte order mark.
    """
    lines = text.decode("utf-8-sig", "replace").splitlines()
    bare = ((k, _COMMENT.split(line)[0].strip()) for k, line in enumerate(lines, 1))
    return [(k, line) for k, line in bare if line]


def columns_of(path: Path) -> int:
    """How many numbers the first line of a table has; 0 if it has other words, or cannot be read.

    Args:
        path: the file.
    """
    lines = lines_of(head_of(path)) if path.is_file() else []
    words = lines[0][1].replace(",", " ").split() if lines else []
    return len(words) if numbers_of_words(words) is not None else 0


def read_rows(path: Path, count: int, rule: str) -> list[tuple[Keys, Float[np.ndarray, " count"]]]:
    """The rows of a table, each with the keys of its line, for messages about it.

    Numbers are separated by blanks or commas. They may be infinite or NaN.

    Args:
        path: the file.
        count: how many numbers a line has; further ones are not read.
        rule: what a line must be, to stand after "must be" in a message.

    Raises:
        CaptureError: a line has fewer numbers, or the file has no line; the message names it.
        OSError: the file cannot be read.
    """
    lines = lines_of(read_text(path))
    within(path, "the lines", len(lines), "frames")
    if not lines:
        raise CaptureError(f"{path}: must hold lines, each {rule}, got none.")
    rows = []
    for number, line in lines:
        keys = Keys(path, {"it": line}, number, kind="line")
        values = numbers_of_words(line.replace(",", " ").split()[:count])
        if values is None or len(values) < count:
            raise keys.error("it", rule)
        rows.append((keys, values))
    return rows


def read_matrix(path: Path, size: int) -> Float[np.ndarray, "size size"]:
    """The square matrix in a text, row by row; its numbers may be infinite or NaN.

    Args:
        path: the file.
        size: how many rows and columns it has.

    Raises:
        CaptureError: it holds anything else.
        OSError: the file cannot be read.
    """
    words = [word for _, line in lines_of(read_text(path)) for word in re.split(r"[\s,]+", line)]
    values = numbers_of_words([word for word in words if word])
    if values is None or len(values) != size**2:
        got = f"{len(words)} words" if values is not None else "words that are no numbers"
        raise CaptureError(
            f"{path}: must hold a matrix, {size} lines of {size} numbers, got {got}."
        )
    return values.reshape(size, size)


def lens_of_matrix(
    keys: Keys, matrix: Float[np.ndarray, "3 3"], key: str = "the matrix"
) -> dict[str, float]:
    """The lens of a matrix K of pixels whose middles are whole numbers, as OpenCV counts, as keys
    of a transforms.json.

    Args:
        keys: where the matrix is, for the message.
        matrix: the matrix.
        key: what the message calls it.

    Raises:
        CaptureError: it is no such matrix.
    """
    (fx, skew, cx), (zero, fy, cy), last = matrix
    finite = bool(np.isfinite(matrix).all())
    if (
        not finite
        or min(fx, fy) <= 0
        or abs(skew) > SLIGHT_SKEW * fx
        or zero
        or list(last) != [0, 0, 1]
    ):
        shown = Keys(keys.file, {key: matrix.tolist()}, keys.frame, keys.prefix, keys.kind)
        raise shown.error(key, "[fx 0 cx; 0 fy cy; 0 0 1] in pixels, with fx and fy above 0")
    return {
        **{"fl_x": float(fx), "fl_y": float(fy)},
        **{"cx": float(cx) + FIRST_PIXEL, "cy": float(cy) + FIRST_PIXEL},
    }


def read_matrix_lens(path: Path) -> dict[str, float]:
    """The lens of a file that holds a matrix K (`lens_of_matrix`)."""
    return lens_of_matrix(Keys(path, {}), read_matrix(path, 3))


def lens_of_coefficients(numbers: Sequence[float]) -> dict[str, Any]:
    """The lens of fx, fy, cx, cy and OpenCV's k1, k2, p1, p2, k3, as keys of a transforms.json.

    Args:
        numbers: the first four or more of these; pixels have their middles at whole numbers.
    """
    fx, fy, cx, cy, *distortion = (float(x) for x in numbers)
    lens = {"fl_x": fx, "fl_y": fy, "cx": cx + FIRST_PIXEL, "cy": cy + FIRST_PIXEL}
    if not any(distortion):
        return lens
    return {**lens, "camera_model": "OPENCV", **dict(zip(_COEFFICIENTS, distortion, strict=False))}


def read_folder_lens(folder: Path) -> dict[str, Any] | None:
    """The lens of a folder's pictures, as keys of a transforms.json; None if no file tells it.

    It is in `camera-intrinsics.txt` (the matrix K); in `calib.txt` (one line fx fy cx cy, then
    perhaps k1 k2 p1 p2 k3; or K); or in `camera.json` (keys of a transforms.json: w, h, fl_x, ...).

    Args:
        folder: the capture's folder.

    Raises:
        CaptureError: the file holds anything else.
        OSError: the file cannot be read.
    """
    path = folder / MATRIX_FILE
    if path.is_file():
        return read_matrix_lens(path)
    path = folder / COEFFICIENTS_FILE
    if path.is_file():
        return _calibration(path)
    path = folder / KEYS_FILE
    if path.is_file():
        content = json_object(path)
        Keys(path, content).number("fl_x")
        return {key: content[key] for key in (*INTRINSICS, "lens") if key in content}
    return None


def missing_lens(folder: Path, known: str) -> CaptureError:
    """The error about pictures with poses whose lens no file tells.

    Args:
        folder: the capture's folder.
        known: other files that would tell it.
    """
    return CaptureError(
        f"{folder}: has poses, but no file tells the lens of its pictures ({known}). Write "
        f"{folder / MATRIX_FILE}: the matrix [fx 0 cx; 0 fy cy; 0 0 1] in pixels of the pictures, "
        "three lines of three numbers."
    )


def _calibration(path: Path) -> dict[str, Any]:
    lines = lines_of(read_text(path))
    if len(lines) == 3:
        return read_matrix_lens(path)
    values = numbers_of_words(lines[0][1].replace(",", " ").split()) if len(lines) == 1 else None
    good = values is not None and len(values) in (4, 8, 9) and bool(np.isfinite(values).all())
    if values is None or not good or min(values[:2]) <= 0:
        raise CaptureError(
            f"{path}: must be one line of four, eight or nine numbers, fx fy cx cy k1 k2 p1 p2 k3, "
            "or the three lines of the matrix [fx 0 cx; 0 fy cy; 0 0 1], in pixels. Write "
            f"{MATRIX_FILE} instead: it is read first."
        )
    return lens_of_coefficients(values.tolist())


def numbers_of_words(words: Sequence[str]) -> Float[np.ndarray, " words"] | None:
    """The numbers that words are; None if a word is no number."""
    try:
        return np.array([_NOT_FINITE.sub("nan", word) for word in words], np.float64)
    except ValueError:
        return None
