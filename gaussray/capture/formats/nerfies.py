"""Captures of Nerfies, HyperNeRF and DyCheck: `dataset.json`, a file in `camera/` for each picture.

They are mostly of one phone that moves around something that moves (Park et al. 2021; Gao et al.
2022).
"""

import json
import re
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.poses import opengl_pose
from gaussray.capture.formats.transforms import json_object, views_of
from gaussray.capture.picture_file import picture_size
from gaussray.capture.points import Points
from gaussray.capture.world_origin import counted_positions
from gaussray.io.safe.arrays import read_npy
from gaussray.io.safe.limits import within


DATASET_FILE, _METADATA_FILE = "dataset.json", "metadata.json"
_POINTS_FILE = "points.npy"
# DyCheck's own split, which counts before that of dataset.json.
_SPLITS = {"train": "splits/train.json", "test": "splits/val.json"}


def is_nerfies(folder: Path) -> bool:
    """Whether a folder holds the files of such a capture."""
    return (folder / DATASET_FILE).is_file() and (folder / "camera").is_dir()


def read_nerfies(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The pictures of `dataset.json`: those of `train_ids`, and held out, of `val_ids`.

    Each picture has a camera in `camera/ID.json`: `orientation` (world to camera, OpenCV axes),
    `position`, `focal_length`, `principal_point` and distortion, for pictures of `image_size`. The
    pictures `ID.png` lie in `rgb/1x/`, else in the least reduced of `rgb/2x/`, `rgb/4x/` ...
    `metadata.json` has for each the number of its time (`time_id`, else `warp_id`) and of its
    `camera_id`; the first time is 0 and the last 1. Starting points come from `points.npy`, which
    has no colours: all are grey. The scale and centre of `scene.json` are not applied.

    Args:
        folder: the folder with the JSON files.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a file contradicts the format; the message names file and key.
        FileNotFoundError: a file does not exist.
    """
    folder = Path(folder)
    split = _split(folder)
    pictures = _pictures(folder)
    metadata = json_object(folder / _METADATA_FILE)
    numbers = {name: _numbers(folder / _METADATA_FILE, metadata, name) for name in split}
    moments = [moment for moment, _ in numbers.values()]
    first, last = min(moments), max(moments)
    frames = []
    for name, part in split.items():
        moment, camera = numbers[name]
        time = (moment - first) / max(last - first, 1)
        values = {"camera": f"cam{camera}", "split": part, "time": time}
        frames.append(_frame(folder, name, pictures, values, len(frames)))
    views = views_of(Keys(folder / DATASET_FILE, {}), frames, dtype)
    end = 1.0 if last > first else 0.0
    return Capture(folder, views, {}, _points(folder / _POINTS_FILE), (0.0, end), "normalised")


def _split(folder: Path) -> dict[str, str]:
    """`train` or `test` for the name of each picture that is used."""
    top = Keys(folder / DATASET_FILE, json_object(folder / DATASET_FILE))
    parts = {"train": _names(top, "train_ids"), "test": _names(top, "val_ids")}
    for part, name in _SPLITS.items():
        if (folder / name).is_file():
            parts[part] = _names(Keys(folder / name, json_object(folder / name)), "frame_names")
    if not parts["train"]:
        parts["train"] = _names(top, "ids")
    # A picture of both lists is held out.
    split = {name: part for part, names in parts.items() for name in names}
    if not split:
        raise top.error("ids", "a list of at least one picture")
    within(top.file, "the pictures", len(split), "frames")
    return split


def _names(keys: Keys, key: str) -> list[str]:
    value = keys.values.get(key, [])
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise keys.error(key, "a list of names of pictures")
    return value


def _pictures(folder: Path) -> str:
    """The folder of the least reduced pictures, as manifests name it."""
    found = [path for path in (folder / "rgb").glob("*x") if re.fullmatch(r"\d+x", path.name)]
    if not found:
        raise FileNotFoundError(f"{folder / 'rgb'}: there is no folder 1x, 2x ... with pictures.")
    return f"rgb/{min(found, key=lambda path: int(path.name[:-1])).name}"


def _numbers(path: Path, metadata: dict[str, Any], name: str) -> tuple[int, int]:
    """Numbers of the time and of the camera of a picture."""
    values = metadata.get(name)
    if not isinstance(values, dict):
        raise CaptureError(f"{path}: {json.dumps(name)} must be a block of keys, got {values!r}.")
    keys = Keys(path, values)
    key = "time_id" if keys.has("time_id") else "warp_id"
    return int(keys.number(key)), int(keys.number("camera_id", 0))


def _frame(folder: Path, name: str, pictures: str, values: dict[str, Any], number: int) -> Keys:
    """One picture as the keys of a frame in a transforms.json."""
    listed = Keys(folder / DATASET_FILE, {"ids": f"{name}.json"})
    path = folder / "camera" / listed.inside("ids").relative_to(folder)
    keys = Keys(path, json_object(path))
    size = np.array(keys.vector("image_size", 2))
    focal, center = keys.number("focal_length"), np.array(keys.vector("principal_point", 2))
    if keys.number("skew", 0.0):
        raise keys.error("skew", "0")
    if not (size > 0).all():
        raise keys.error("image_size", "two numbers above 0")
    picture = f"{pictures}/{name}.png"
    stored = Keys(folder / DATASET_FILE, {"ids": picture}).inside("ids")
    shown = picture_size(stored) if stored.is_file() else size.round().astype(int)
    factor = np.asarray(shown) / size
    radial = keys.vector("radial_distortion", 3, [0.0] * 3)
    # HyperNeRF's first captures name it shorter.
    key = "tangential" if keys.has("tangential") else "tangential_distortion"
    tangential = keys.vector(key, 2, [0.0] * 2)
    lens = dict(zip(("k1", "k2", "k3", "p1", "p2"), (*radial, *tangential), strict=True))
    distortion = lens if any(lens.values()) else {}
    aspect = keys.number("pixel_aspect_ratio", 1.0)
    # Pictures are named from the capture's folder.
    return Keys(
        folder / DATASET_FILE,
        {
            **values,
            **{"file_path": picture, "transform_matrix": _pose(keys)},
            **{"w": int(shown[0]), "h": int(shown[1])},
            **{"fl_x": focal * factor[0], "fl_y": focal * aspect * factor[1]},
            **{"cx": center[0] * factor[0], "cy": center[1] * factor[1]},
            **distortion,
        },
        number,
    )


def _pose(keys: Keys) -> np.ndarray:
    """Camera to world, with OpenGL's camera axes."""
    rows = keys.values.get("orientation")
    try:
        turn = np.array(rows, np.float64)
    except (TypeError, ValueError, OverflowError):
        turn = np.empty(0)
    if turn.shape != (3, 3):
        raise keys.error("orientation", "a 3 x 3 rotation matrix, world to camera")
    matrix = opengl_pose(turn.T, keys.vector("position", 3))
    return Keys(keys.file, {"orientation": matrix}).pose("orientation")


def _points(path: Path) -> Points | None:
    if not path.is_file():
        return None
    try:
        table = read_npy(path)
    except ValueError as error:
        raise CaptureError(f"{path}: the file must be a NumPy array: {error}") from None
    if table.ndim != 2 or table.shape[1] != 3 or table.dtype.kind != "f":
        raise CaptureError(f"{path}: the array must be real numbers [points, 3].")
    table = counted_positions(table[np.isfinite(table).all(axis=1)]).astype(np.float32)
    return Points(table, np.full(table.shape, 0.5, np.float32)) if len(table) else None
