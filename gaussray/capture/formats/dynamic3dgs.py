"""Captures of Dynamic 3D Gaussians (Luiten et al. 2024): `train_meta.json` and pictures in `ims/`.

CMU's Panoptic Studio captures come in this layout: a dome of cameras that stand still.
"""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.transforms import json_object, views_of
from gaussray.capture.points import Points
from gaussray.capture.world_origin import counted_positions
from gaussray.color import srgb_decode
from gaussray.geometry import BLENDER_AXES
from gaussray.io.safe.arrays import read_npz
from gaussray.io.safe.limits import within


META_FILES = {"train": "train_meta.json", "test": "test_meta.json"}
POINTS_FILE = "init_pt_cld.npz"
_LISTS = ("k", "w2c", "fn", "cam_id")


def read_dynamic3dgs(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The pictures of `train_meta.json` and, held out, of `test_meta.json`.

    Each file has `w`, `h` and, by time step and camera, the lists `k` (3 x 3 intrinsics), `w2c`
    (4 x 4, OpenCV axes), `fn` (the picture in `ims/`) and `cam_id`. Step i of n is at time i / n.
    Starting points come from `init_pt_cld.npz`: x y z, red green blue in 0..1, in each row.

    Args:
        folder: the folder with the JSON files, the points and `ims/`.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a file contradicts the format; the message names file, frame and key.
        FileNotFoundError: `train_meta.json` does not exist.
    """
    folder = Path(folder)
    views = []
    for split, name in META_FILES.items():
        if split == "train" or (folder / name).is_file():
            top, frames = _frames(folder / name, split)
            views += views_of(top, frames, dtype)
    times = [view.time for view in views]
    points = _points(folder / POINTS_FILE)
    return Capture(folder, views, {}, points, (min(times), max(times)), "normalised")


def _frames(path: Path, split: str) -> tuple[Keys, list[Keys]]:
    top = Keys(path, json_object(path))
    size = {"w": top.count("w"), "h": top.count("h")}
    steps = [_list(top, key, None) for key in _LISTS]
    if len({len(x) for x in steps}) != 1 or not steps[0]:
        raise CaptureError(
            f"{path}: {', '.join(_LISTS)} must have as many time steps, at least one, got "
            f"{', '.join(str(len(x)) for x in steps)}."
        )
    within(path, "the frames", sum(len(x) for x in steps[0] if isinstance(x, list)), "frames")
    frames: list[Keys] = []
    for i, rows in enumerate(zip(*steps, strict=True)):
        rows = [_list(top, f"{key}[{i}]", row) for key, row in zip(_LISTS, rows, strict=True)]
        if len({len(row) for row in rows}) != 1:
            raise CaptureError(
                f"{path}: {', '.join(_LISTS)} must have as many cameras at time step {i}, got "
                f"{', '.join(str(len(row)) for row in rows)}."
            )
        for row in zip(*rows, strict=True):
            values = {**size, "split": split, "time": i / len(steps[0])}
            frames.append(_frame(path, len(frames), row, values))
    return Keys(path, {}), frames


def _list(top: Keys, key: str, value: Any) -> list[Any]:
    value = top.values.get(key) if value is None else value
    if not isinstance(value, list):
        raise Keys(top.file, {key: value}).error(key, "a list")
    return value


def _frame(path: Path, number: int, row: tuple[Any, ...], values: dict[str, Any]) -> Keys:
    """One picture as the keys of a frame in a transforms.json."""
    intrinsics, pose, name, camera = row
    keys = Keys(path, {"k": intrinsics, "w2c": pose, "fn": name}, number)
    matrix = _matrix(keys, "k", 3)
    if matrix[0, 1] or matrix[1, 0]:
        raise keys.error("k", "a 3 x 3 matrix without skew")
    camera_from_world = _matrix(keys, "w2c", 4)
    try:
        world_from_camera = np.linalg.inv(camera_from_world)
    except np.linalg.LinAlgError:
        raise keys.error("w2c", "an invertible 4 x 4 matrix") from None
    if np.linalg.det(world_from_camera[:3, :3]) < 0:
        rule = "a world-to-camera matrix without reflection"
        remedy = (
            "Its determinant is -1, so it mirrors; that of a rotation is +1. If all have it, the "
            "world is left-handed: negate the third column of each w2c, and z of the points. If "
            "pictures do not fit then, the matrices may be camera-to-world: invert them first."
        )
        raise keys.error("w2c", rule, remedy)
    # OpenGL's camera axes, which a transform_matrix has.
    world_from_camera[:3, :3] *= np.array(BLENDER_AXES)
    return Keys(
        path,
        {
            **values,
            **{"file_path": f"ims/{keys.text('fn')}", "camera": f"cam{camera}"},
            **{"transform_matrix": world_from_camera},
            **{"fl_x": float(matrix[0, 0]), "fl_y": float(matrix[1, 1])},
            **{"cx": float(matrix[0, 2]), "cy": float(matrix[1, 2])},
        },
        number,
    )


def _matrix(keys: Keys, key: str, side: int) -> np.ndarray:
    rule = f"a {side} x {side} matrix of finite numbers"
    try:
        matrix = np.array(keys.values[key], np.float64)
    except (TypeError, ValueError, OverflowError):
        raise keys.error(key, rule) from None
    if matrix.shape != (side, side) or not np.isfinite(matrix).all():
        raise keys.error(key, rule)
    return matrix


def _points(path: Path) -> Points | None:
    if not path.is_file():
        return None
    try:
        table = read_npz(path).get("data")
    except ValueError as error:
        raise CaptureError(f"{path}: the file must hold arrays of NumPy: {error}") from None
    good = table is not None and table.ndim == 2 and table.shape[1] >= 6 and len(table)
    if table is None or not good or table.dtype.kind != "f" or not np.isfinite(table).all():
        raise CaptureError(
            f"{path}: the array `data` must be finite numbers [points, 7]: x y z, red green blue "
            "and a label."
        )
    color = srgb_decode(np.clip(table[:, 3:6].astype(np.float64), 0, 1))
    return Points(counted_positions(table[:, :3]).astype(np.float32), color.astype(np.float32))
