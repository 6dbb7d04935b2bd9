"""Technicolor's light field videos (Sabater et al. 2017): `cameras_parameters.txt` and pictures."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.number_files import numbers_of_words
from gaussray.capture.formats.poses import opengl_pose, quaternion_turn
from gaussray.capture.formats.rig import numbered_pictures, rig_capture
from gaussray.io.safe.files import read_text
from gaussray.io.safe.limits import within


PARAMETERS_FILE = "cameras_parameters.txt"
# Of the pictures that the parameters belong to.
_WIDTH, _HEIGHT = 2048, 1088
# Held out by HyperReel and by Spacetime Gaussians.
_HELD_OUT = "cam10"
_COLUMNS = 12
# The largest number of a quaternion is above this.
_LEAST = 1e-6
_REMEDY = "Copy the file as it comes with the pictures."


def read_technicolor(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The pictures of the cameras that `cameras_parameters.txt` lists.

    A row is a camera: focal length, principal point (2), aspect, skew, a quaternion (w, x, y, z)
    and a translation (3), world to camera (OpenCV's axes), for pictures of 2048 x 1088. A first
    line of words is skipped. Camera 3 is called cam03, and its picture at frame 12 ends with
    `_00012_03.png` or another suffix, in the folder or in `images/`. Frames in the order of their
    numbers are at times i / n. `cam10` is held out.

    Args:
        folder: the folder with `cameras_parameters.txt`.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format; the message names the line.
        FileNotFoundError: `cameras_parameters.txt` does not exist.
    """
    path = Path(folder) / PARAMETERS_FILE
    rows = _rows(path)
    paths = [*path.parent.glob("*"), *(path.parent / "images").glob("*")]
    found = numbered_pictures(path.parent, paths, r"(.*[_/])?(?P<number>\d+)_(?P<camera>\d+)")
    pictures = {f"cam{int(number):02d}": some for number, some in found.items()}
    return rig_capture(Keys(path, {}), [_camera(row) for row in rows], pictures, dtype)


def _rows(path: Path) -> list[Keys]:
    """The numbers of each row, as a row's key `numbers`."""
    lines = [line.split() for line in read_text(path).decode("utf-8-sig", "replace").splitlines()]
    lines = [words for words in lines if words]
    if lines and numbers_of_words(lines[0]) is None:
        lines = lines[1:]
    if not lines:
        raise CaptureError(f"{path}: must have a row of numbers for each camera. {_REMEDY}")
    within(path, "the cameras", len(lines), "frames")
    rows = []
    for k, words in enumerate(lines):
        numbers = numbers_of_words(words)
        if len(words) != _COLUMNS or numbers is None:
            raise CaptureError(
                f"{path}: the row of camera {k} must be {_COLUMNS} numbers, got "
                f"{' '.join(words)[:80]}. {_REMEDY}"
            )
        rows.append(Keys(path, {"numbers": numbers.tolist()}, k, kind="camera"))
    return rows


def _camera(row: Keys) -> Keys:
    """The keys of a camera as of a frame in a transforms.json."""
    focal, cx, cy, aspect, skew, *pose = row.vector("numbers", _COLUMNS)
    if skew:
        row.warn(f"the skew {skew:g} is left out.")
    quat, translation = np.array(pose[:4]), np.array(pose[4:])
    if not np.abs(quat).max() > _LEAST:
        raise row.error("numbers", "numbers with a quaternion that is not 0", _REMEDY)
    turn, name = quaternion_turn(quat).T, f"cam{row.frame:02d}"
    values = {
        **{"w": _WIDTH, "h": _HEIGHT, "fl_x": focal, "fl_y": focal * aspect},
        **{"cx": cx, "cy": cy, "camera": name},
        **{"split": "test" if name == _HELD_OUT else "train"},
        "transform_matrix": opengl_pose(turn, -turn @ translation),
    }
    return dataclasses.replace(row, values=values)
