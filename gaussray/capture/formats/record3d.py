"""Captures of Record3D, an app for iPhones and iPads: `metadata.json`, and pictures in `rgb/`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.poses import quaternion_turn
from gaussray.capture.formats.time_order import check_later
from gaussray.capture.formats.transforms import json_if_readable, points_of, views_of
from gaussray.io.safe.limits import within


# The files of the app's export as EXR and RGB, and of an unpacked .r3d.
METADATA_FILES = ("metadata.json", "metadata")
_PICTURES = ("rgb", "rgbd")
_KEYS = ("w", "h", "K", "poses")
# No rate of frames is higher, as all times would be 0 in single precision, and none is lower than
# its inverse, as they would be infinite.
_FASTEST = 1e20
_POSE = "a list of seven numbers: the quaternion x, y, z, w, which is not zero, and the position"


def record3d_file(folder: Path) -> Path | None:
    """The file of cameras of such a capture; None if the folder holds none, or no pictures."""
    if not any((folder / name).is_dir() for name in _PICTURES):
        return None
    return next((folder / name for name in METADATA_FILES if _metadata(folder / name)), None)


def read_record3d(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The frames of one camera that moves: the k-th has the picture `rgb/k.jpg`.

    Poses are ARKit's, in metres; times are seconds (`frameTimestamps`, otherwise k / `fps`). The
    lens is that of each frame (`perFrameIntrinsicCoeffs`: focal lengths and principal point), else
    `K`, column by column. Depth maps are not read; no frame is held out.

    Args:
        folder: the folder with metadata.json and `rgb/`.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format; the message names it and the key.
        FileNotFoundError: there is no such file.
    """
    folder = Path(folder)
    path = record3d_file(folder)
    if path is None:
        raise FileNotFoundError(f"{folder}: holds no metadata.json of Record3D beside rgb/.")
    top = Keys(path, _metadata(path))
    poses = _listed(top, "poses")
    within(path, "the poses", len(poses), "frames")
    if not poses:
        raise top.error("poses", "a list of at least one pose")
    size = {"w": top.count("w"), "h": top.count("h")}
    times, lenses = _times(top, len(poses)), _lenses(top, len(poses))
    pictures = next(name for name in _PICTURES if (folder / name).is_dir())
    frames = []
    for k, pose in enumerate(poses):
        keys = {"file_path": f"{pictures}/{k}.jpg", "camera": "record3d", "split": "train"}
        keys |= {**size, **lenses[k], "time": times[k], "transform_matrix": _matrix(path, k, pose)}
        frames.append(Keys(path, keys, k))
    views = views_of(top, frames, dtype)
    return Capture(folder, views, {}, points_of(top), (min(times), max(times)), "seconds")


def _metadata(path: Path) -> Mapping[str, Any]:
    """The content of a file of Record3D; empty if it is none."""
    content = json_if_readable(path)
    known = isinstance(content, dict) and all(key in content for key in _KEYS)
    return content if known else {}


def _listed(top: Keys, key: str, count: int | None = None) -> list[Any]:
    """A list, of an entry for each frame if `count` says so."""
    value = top.values.get(key)
    if not isinstance(value, list) or count is not None and len(value) != count:
        raise top.error(key, "a list" if count is None else f"a list of {count}, as poses is")
    return value


def _times(top: Keys, count: int) -> list[float]:
    if top.has("frameTimestamps"):
        _listed(top, "frameTimestamps", count)
        times = top.vector("frameTimestamps", count)
        _check_times(top.file, times)
        return times
    rate = top.number("fps")
    if rate <= 0:
        raise top.error("fps", "above 0")
    if not 1 / _FASTEST <= rate <= _FASTEST:
        raise top.error("fps", f"from {1 / _FASTEST:g} to {_FASTEST:g}")
    return [k / rate for k in range(count)]


def _check_times(path: Path, times: Sequence[float]) -> None:
    """Times of one camera, which is at one place at a time."""
    before = -np.inf
    for k, time in enumerate(times):
        keys = Keys(path, {"frameTimestamps": time}, k)
        check_later(keys, "frameTimestamps", time, before, f"that of frame {k - 1}")
        before = time


def _lenses(top: Keys, count: int) -> list[dict[str, float]]:
    """The lens of each frame, as keys of a transforms.json."""
    if top.values.get("perFrameIntrinsicCoeffs"):
        rows = _listed(top, "perFrameIntrinsicCoeffs", count)
        numbered = [
            Keys(top.file, {"perFrameIntrinsicCoeffs": row}, k) for k, row in enumerate(rows)
        ]
        values = [keys.vector("perFrameIntrinsicCoeffs", 4) for keys in numbered]
    else:
        matrix = np.reshape(top.vector("K", 9), (3, 3)).T
        if np.any(matrix[[0, 1, 2, 2], [1, 0, 0, 1]]) or matrix[2, 2] != 1:
            raise top.error("K", "a matrix, column by column: fx 0 0, 0 fy 0, cx cy 1")
        values = [matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()] * count
    return [dict(zip(("fl_x", "fl_y", "cx", "cy"), row, strict=True)) for row in values]


def _matrix(path: Path, index: int, pose: Any) -> list[list[float]]:
    """Camera to world of a frame; ARKit's cameras have OpenGL's axes."""
    keys = Keys(path, {"poses": pose}, index)
    try:
        numbers = np.array(keys.vector("poses", 7))
    except CaptureError:
        raise keys.error("poses", _POSE) from None
    largest = np.abs(numbers[:4]).max()
    if not largest > 0:
        raise keys.error("poses", _POSE)
    matrix = np.eye(4)
    # Squares of the largest and of the smallest numbers would be infinite or 0.
    matrix[:3, :3] = quaternion_turn(numbers[[3, 0, 1, 2]] / largest)
    matrix[:3, 3] = numbers[4:]
    return matrix.tolist()
