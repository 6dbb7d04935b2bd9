"""Camera paths from files: a capture's own, nerfstudio's and TUM's."""

from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.effects import quaternions
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.transforms import json_content
from gaussray.io.safe.files import read_text


# Keys of a path file that are fields of view, and their units.
_LENS_KEYS = {
    "fov": "degrees from top to bottom",
    "camera_angle_x": "radians from left to right",
    "fl_x": "pixels",
}


class PathLens(NamedTuple):
    """The field of view that a path file holds: key, least and largest value, unit, and what the
    first is in degrees from left to right (None: the file does not tell the shape of its pictures).
    """

    key: str
    least: float
    largest: float
    unit: str
    degrees: float | None


def read_path(
    path: Path | str,
) -> tuple[Float[np.ndarray, " poses"], Float[np.ndarray, "poses 4"], Float[np.ndarray, "poses 3"]]:
    """Times, and world_from_camera as quaternions and places, of a file in the scene's own world.

    JSON: `trajectory` or `frames` of {time, transform_matrix} (OpenGL axes, as captures have), or
    nerfstudio's `camera_path` of {camera_to_world}, evenly over its `seconds` (1 without); fields
    of view are not read (see `lens_of_path`). Anything else is text in the format of the TUM RGB-D
    benchmark: `time x y z qx qy qz qw` on each line, camera axes +x right, +y down, +z forward, # a
    comment.

    Raises:
        CaptureError: the file is malformed, or its times do not increase.
    """
    path = Path(path)
    times, quat, position = _of_json(path) if path.suffix == ".json" else _of_text(path)
    falls = np.flatnonzero(np.diff(times) <= 0)
    if len(falls):
        raise CaptureError(
            f"{path}: the times of a path must strictly increase, got {times[falls[0] + 1]} after "
            f"{times[falls[0]]}. Keep the poses of one camera, one for each time."
        )
    return times, quat, position


def lens_of_path(path: Path | str) -> PathLens | None:
    """The field of view in a file of `read_path`, which reads poses alone; None if it has none.

    Raises:
        CaptureError: the file is malformed.
    """
    path = Path(path)
    if path.suffix != ".json":
        return None
    content = json_content(path)
    _, entries = _entries(path, content)
    for key, unit in _LENS_KEYS.items():
        blocks = [{**content, **entry.values} for entry in entries]
        blocks = [block for block in blocks if _is_positive(block.get(key))]
        if blocks:
            values = [float(block[key]) for block in blocks]
            return PathLens(key, min(values), max(values), unit, _degrees_across(key, blocks[0]))
    return None


def _degrees_across(key, block):
    """Horizontal field of view of a block's key; None if its shape is not known, or it is no
    pinhole's."""
    kinds = str(block.get("camera_model", "PINHOLE")), str(block.get("camera_type", "perspective"))
    if kinds[0].upper() not in ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV") or kinds[1] != "perspective":
        return None
    degrees = _pinhole_degrees(key, block)
    return degrees if degrees is not None and 0 < degrees < 180 else None


def _pinhole_degrees(key, block):
    if key == "camera_angle_x":
        return float(np.degrees(block[key]))
    if key == "fov" and block[key] >= 180:
        return None
    if key == "fl_x":
        width = block.get("w")
        half = width / 2 / block[key] if _is_positive(width) else None
    else:
        width, height = block.get("render_width"), block.get("render_height")
        aspect = block.get("aspect")
        if not _is_positive(aspect) and _is_positive(width) and _is_positive(height):
            aspect = width / height
        half = aspect * np.tan(np.radians(block[key]) / 2) if _is_positive(aspect) else None
    return None if half is None else float(np.degrees(2 * np.arctan(half)))


def _is_positive(value):
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # Whole numbers of JSON may be larger than any float.
    return number and 0 < value < 1e30


def _entries(path, content):
    """The key of a path in a JSON file, and the blocks under it."""
    known = "trajectory", "frames", "camera_path"
    found = [key for key in known if isinstance(content, dict) and content.get(key)]
    if not found:
        raise CaptureError(f"{path}: trajectory.file must hold one of {', '.join(known)}.")
    listed = content[found[0]]
    if found[0] == "trajectory" and isinstance(listed, dict):
        listed = listed.get("poses")
    blocks = isinstance(listed, list) and all(isinstance(entry, dict) for entry in listed)
    if not (blocks and listed):
        raise Keys(path, content).error(found[0], "a list of blocks")
    entries = [Keys(path, entry, prefix=f"{found[0]}[{k}].") for k, entry in enumerate(listed)]
    return found[0], entries


def _of_json(path):
    content = json_content(path)
    found, entries = _entries(path, content)
    if found == "camera_path":
        seconds = Keys(path, content).number("seconds", 1.0)
        times = np.linspace(0, seconds, len(entries))
        pose = [_unrolled(entry).pose("camera_to_world") for entry in entries]
    else:
        times = np.array([entry.number("time") for entry in entries])
        pose = [entry.pose() for entry in entries]
    pose = np.stack(pose)
    return times, np.asarray(quaternions(pose, jnp.float32)), pose[:, :, 3]


def _unrolled(keys):
    """A matrix may stand as one row of sixteen numbers."""
    value = keys.values.get("camera_to_world")
    if not isinstance(value, list) or len(value) != 16:
        return keys
    rows = [value[i : i + 4] for i in range(0, 16, 4)]
    return Keys(keys.file, {**keys.values, "camera_to_world": rows}, prefix=keys.prefix)


def _of_text(path):
    try:
        lines = read_text(path).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise OSError(f"trajectory.file={path}: cannot be read: {error}") from error
    rows = []
    for number, line in enumerate(lines, 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            row = np.array(words, np.float64)
        except ValueError:
            row = np.empty(0)
        if row.shape != (8,) or not np.isfinite(row).all() or not row[4:].any():
            raise CaptureError(
                f"{path}, line {number}: must be time x y z qx qy qz qw, eight finite numbers with "
                f"a quaternion that is not zero, got {line[:200]!r}."
            )
        rows.append(row)
    if not rows:
        raise CaptureError(f"{path}: trajectory.file must hold at least one pose, got none.")
    table = np.stack(rows)
    return table[:, 0], table[:, [7, 4, 5, 6]], table[:, 1:4]
