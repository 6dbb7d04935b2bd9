"""Captures of Middlebury's multi-view stereo (Seitz et al. 2006): cameras in `NAME_par.txt`."""

import dataclasses
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.completion import completed
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.number_files import lens_of_matrix
from gaussray.capture.formats.poses import opengl_pose
from gaussray.capture.formats.project_files import head_of
from gaussray.capture.formats.sfm_project import distinct_names, rotation_in
from gaussray.capture.formats.transforms import points_of, views_of
from gaussray.io.safe.files import read_text
from gaussray.io.safe.limits import within


# The file of cameras.
PAR_FILE = "*_par.txt"
# K and R, row by row, then t.
_NUMBERS = 21


def middlebury_file(folder: Path) -> Path | None:
    """The file of cameras of such a capture, the first by name; None if there is none."""
    return next((path for path in sorted(folder.glob(PAR_FILE)) if _is_par(path)), None)


def read_middlebury(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """A still scene: each line of `NAME_par.txt` has a picture's name, and K, R and t of it.

    A projection is K [R t] in OpenCV's axes, of pixels whose middles are whole numbers. None of the
    pictures is held out.

    Args:
        folder: the folder with the file and the pictures.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a line is none of a camera; the message names it.
        FileNotFoundError: no such file is there, or none of its pictures.
    """
    folder = Path(folder)
    path = middlebury_file(folder)
    if path is None:
        raise FileNotFoundError(f"{folder}: holds no {PAR_FILE} with K, R and t of each picture.")
    lines = _lines(read_text(path))
    top, count = Keys(path, {}), int(lines[0])
    if count != len(lines) - 1:
        top.warn(
            f"the first line says {count} pictures, but {len(lines) - 1} follow: all are read."
        )
    others = [other.name for other in sorted(folder.glob(PAR_FILE)) if other != path]
    if any(_is_par(folder / name) for name in others):
        top.warn(f"{', '.join(others)} is not read. Move this file away to read another.")
    within(path, "the pictures", len(lines) - 1, "frames")
    frames = completed([_frame(path, k, line) for k, line in enumerate(lines[1:])])
    names = distinct_names(top, folder, [frame.inside("file_path") for frame in frames])
    frames = [
        dataclasses.replace(frame, values={**frame.values, "camera": name})
        for name, frame in zip(names, frames, strict=True)
    ]
    views = views_of(top, frames, dtype)
    return Capture(folder, views, {}, points_of(top), (0.0, 0.0), "normalised")


def _lines(text: bytes) -> list[str]:
    """The lines of a text that are not blank."""
    lines = text.decode("utf-8-sig", "replace").splitlines()
    return [line.strip() for line in lines if line.strip()]


def _is_par(path: Path) -> bool:
    """Whether the first two lines are how many pictures there are, and a camera."""
    count, camera, *_ = [*_lines(head_of(path)), "", ""]
    if not re.fullmatch("[0-9]{1,9}", count):
        return False
    _, *numbers = camera.rsplit(maxsplit=_NUMBERS) or [""]
    return len(numbers) == _NUMBERS and all(re.fullmatch(r"[-+0-9.eE]+", x) for x in numbers)


def _frame(path: Path, index: int, line: str) -> Keys:
    """The keys of a picture, as in a transforms.json."""
    name, *numbers = line.rsplit(maxsplit=_NUMBERS)
    keys = Keys(path, {"line": line}, index, kind="picture")
    rule = f"a picture's name and {_NUMBERS} finite numbers: K and R, row by row, and t"
    try:
        values = np.array(numbers, np.float64)
    except ValueError:
        raise keys.error("line", rule) from None
    if len(values) != _NUMBERS or not np.isfinite(values).all():
        raise keys.error("line", rule)
    try:
        lens = lens_of_matrix(keys, values[:9].reshape(3, 3))
    except CaptureError:
        rule = "one whose K is [fx 0 cx; 0 fy cy; 0 0 1] with fx and fy above 0"
        raise keys.error("line", rule) from None
    turn = rotation_in(keys, "line", values[9:18].tolist()).T
    pose = opengl_pose(turn, -turn @ values[18:])
    return Keys(
        path,
        {
            **{"file_path": name, **lens},
            **{"transform_matrix": pose.tolist(), "split": "train", "time": 0.0},
        },
        index,
        kind="picture",
    )
