"""ActorsHQ (Isik et al. 2023): `calibration.csv` and the pictures of a dome in `rgbs/`."""

import csv
import dataclasses
import io
from pathlib import Path

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.poses import axis_angle_turn, opengl_pose
from gaussray.capture.formats.rig import numbered_pictures, rig_capture
from gaussray.io.safe.files import read_text
from gaussray.io.safe.limits import within


CALIBRATION_FILE, _PICTURES = "calibration.csv", "rgbs"
_COLUMNS = ("name", "w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py")
# Its authors' test cameras.
_HELD_OUT = {
    f"Cam{number:03d}" for number in (1, 14, 25, 31, 44, 58, 64, 65, 71, 85, 98, 104, 115, 127)
}
_REMEDY = "Copy the file as it comes with the pictures."


def is_actorshq(folder: Path) -> bool:
    """Whether a folder holds a calibration.csv beside the pictures of its cameras."""
    return (folder / CALIBRATION_FILE).is_file() and (folder / _PICTURES).is_dir()


def read_actorshq(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The pictures of the cameras that `calibration.csv` lists.

    Its columns are `name`, `w`, `h`, a rotation `rx`, `ry`, `rz` (camera to world, axis times
    angle; OpenCV's axes), the camera's place `tx`, `ty`, `tz`, and focal lengths `fx`, `fy` and
    principal point `px`, `py` in widths and heights of the picture. Pictures are
    `rgbs/Cam001/Cam001_rgb000000.jpg`; those of one number have one time, i / n in the order of
    numbers. They show black where the actor is not, so masks are not read. The authors' 14 test
    cameras are held out.

    Args:
        folder: the folder of a sequence at one scale, such as `Actor01/Sequence1/4x`.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format; the message names row and column.
        FileNotFoundError: `calibration.csv` does not exist.
    """
    path = Path(folder) / CALIBRATION_FILE
    cameras = [_camera(row) for row in _rows(path)]
    paths = (path.parent / _PICTURES).glob("*/*")
    name = rf"{_PICTURES}/(?P<camera>[^/]+)/.*_rgb(?P<number>\d+)"
    pictures = numbered_pictures(path.parent, paths, name)
    return rig_capture(Keys(path, {}), cameras, pictures, dtype)


def _rows(path: Path) -> list[Keys]:
    text = read_text(path).decode("utf-8-sig", "replace")
    rows = csv.DictReader(io.StringIO(text), skipinitialspace=True)
    try:
        listed = [dict(row) for row in rows]
    except csv.Error as error:
        raise CaptureError(f"{path}: must be a table: {error}. {_REMEDY}") from None
    missing = [name for name in _COLUMNS if name not in (rows.fieldnames or ())]
    if missing or not listed:
        raise CaptureError(
            f"{path}: must have the columns {', '.join(_COLUMNS)} and a row for each camera, got "
            f"{len(listed)} rows without {', '.join(missing) or 'any lack'}. {_REMEDY}"
        )
    within(path, "the cameras", len(listed), "frames")
    return [_numbers(path, k, row) for k, row in enumerate(listed)]


def _numbers(path: Path, k: int, row: dict) -> Keys:
    values = {"name": row["name"]}
    for name in _COLUMNS[1:]:
        try:
            values[name] = float(row[name])
        except (TypeError, ValueError):
            raise Keys(path, row, k, kind="camera").error(name, "a number", _REMEDY) from None
    return Keys(path, values, k, kind="camera")


def _camera(row: Keys) -> Keys:
    """The keys of a camera as of a frame in a transforms.json."""
    width, height, name = row.count("w"), row.count("h"), row.text("name")
    turn = axis_angle_turn([row.number(x) for x in ("rx", "ry", "rz")])
    place = [row.number(x) for x in ("tx", "ty", "tz")]
    values = {
        **{"w": width, "h": height, "camera": name},
        **{"fl_x": row.number("fx") * width, "fl_y": row.number("fy") * height},
        **{"cx": row.number("px") * width, "cy": row.number("py") * height},
        **{"split": "test" if name in _HELD_OUT else "train"},
        "transform_matrix": opengl_pose(turn, place),
    }
    return dataclasses.replace(row, values=values)
