"""Camera paths from files: a capture's own, nerfstudio's and TUM's."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.effects import quaternions
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.transforms import json_content
from gaussray.io.safe.files import read_text


def read_path(
    path: Path | str,
) -> tuple[Float[np.ndarray, " poses"], Float[np.ndarray, "poses 4"], Float[np.ndarray, "poses 3"]]:
    """Times, and world_from_camera as quaternions and places, of a file in the scene's own world.

    JSON: `trajectory` or `frames` of {time, transform_matrix} (OpenGL axes, as captures have), or
    nerfstudio's `camera_path` of {camera_to_world}, evenly over its `seconds` (1 without); its
    fields of view are not read. Anything else is text in the format of the TUM RGB-D benchmark:
    `time x y z qx qy qz qw` on each line, camera axes +x right, +y down, +z forward, # a comment.

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


def _of_json(path):
    content = json_content(path)
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
    if found[0] == "camera_path":
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
