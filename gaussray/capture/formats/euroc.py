"""Captures in the layout of EuRoC's flights (Burri et al. 2016): cameras of one body that moves, in
`mav0/cam0/` and `mav0/cam1/`, and the trajectory of the body."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import yaml
from jaxtyping import DTypeLike, Float

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys, block_in
from gaussray.capture.formats.number_files import lens_of_coefficients, read_rows
from gaussray.capture.formats.picture_places import KNOWN_SUFFIXES
from gaussray.capture.formats.posed_pictures import (
    PosedPicture,
    by_time,
    interpolated_poses,
    posed_capture,
)
from gaussray.io.safe.aliases import check_aliases
from gaussray.io.safe.files import read_text


# The folders of sensors, below the capture's; of trajectories the first that exists is read.
_HOME, _CAMERAS = "mav0", "cam[0-9]"
_TRAJECTORIES = ("state_groundtruth_estimate0", "vicon0", "mocap0")
SENSOR_FILE, _TABLE = "sensor.yaml", "data.csv"
_ROW = "a time in nanoseconds, the position x y z and the quaternion w x y z"
# Largest size of a sensor.yaml: YAML is read slowly.
_MOST_BYTES = 1_000_000
# The models of lenses and of distortions, and their coefficients here.
_DISTORTIONS = {
    "radial-tangential": ("OPENCV", ("k1", "k2", "p1", "p2")),
    "equidistant": ("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
    "none": ("PINHOLE", ()),
}


def euroc_file(folder: Path) -> Path | None:
    """The trajectory of such a capture; None if the folder holds none, or no camera."""
    home = _home(folder)
    if not any((path / "data").is_dir() for path in home.glob(_CAMERAS)):
        return None
    paths = (home / name / _TABLE for name in _TRAJECTORIES)
    return next((path for path in paths if path.is_file()), None)


def euroc_near_miss(folder: Path) -> str:
    """What a folder with a camera or a trajectory of EuRoC's lacks; empty if it has neither, or
    lacks nothing."""
    home = _home(folder)
    tables = (home / name / _TABLE for name in _TRAJECTORIES)
    table = next((path for path in tables if path.is_file()), None)
    sensor = min(home.glob(f"{_CAMERAS}/{SENSOR_FILE}"), default=None)
    found = sensor or table
    if found is None or euroc_file(folder) is not None:
        return ""
    where = home.relative_to(folder)
    lacking = []
    if not any((path / "data").is_dir() for path in home.glob(_CAMERAS)):
        camera = sensor.parent.name if sensor else "cam0"
        lacking.append(f"pictures in {where / camera / 'data'}/, named by nanoseconds")
    if table is None:
        others = " or ".join(f"{name}/" for name in _TRAJECTORIES[1:])
        lacking.append(f"the trajectory {where / _TRAJECTORIES[0] / _TABLE} (or in {others})")
    needs = " and ".join(lacking)
    return f"{found.relative_to(folder)} is a file of EuRoC's. It needs {needs}."


def read_euroc(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The pictures of the cameras of a body that moves, by their times in seconds.

    Pictures `mav0/cam0/data/TIME.png` are named by nanoseconds. The table of the body has `time, x,
    y, z, qw, qx, qy, qz` on each line; `sensor.yaml` of a camera has its lens (pinhole without
    distortion, radial-tangential or equidistant) and the matrix `T_BS` from it to the body, in
    OpenCV's axes. Pictures further than 0.02 s from any pose are left out with one warning; none
    is held out. The middle of the first pixel is 0.

    Args:
        folder: the folder around `mav0/`, or this.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a file contradicts the format; the message names it and the key or line.
        FileNotFoundError: there are no such files.
    """
    folder = Path(folder)
    path = euroc_file(folder)
    if path is None:
        lacks = f"holds no {_HOME}/{_TRAJECTORIES[0]}/{_TABLE} beside {_HOME}/cam0/data/."
        raise FileNotFoundError(f"{folder}: {euroc_near_miss(folder) or lacks}")
    rows = np.stack([values for _, values in read_rows(path, 8, _ROW)])
    times, quats = rows[:, 0] * 1e-9, rows[:, [5, 6, 7, 4]]
    top = Keys(folder / _HOME, {})
    body_from_tracked = np.eye(4)
    if (path.parent / SENSOR_FILE).is_file():
        tracked = _sensor(path.parent / SENSOR_FILE)
        body_from_tracked = _matrix(tracked) if tracked.has("T_BS") else body_from_tracked
    pictures = []
    for camera in sorted(_home(folder).glob(_CAMERAS)):
        found = _pictures(camera / "data")
        if not found:
            continue
        sensor = _sensor(camera / SENSOR_FILE)
        lens, body_from_camera = _lens(sensor), _matrix(sensor)
        tracked_from_camera = np.linalg.inv(body_from_tracked) @ body_from_camera
        matrices, known = interpolated_poses(times, quats, rows[:, 1:4], np.array(list(found)))
        for time, matrix, has in zip(found, matrices, known, strict=True):
            name = (camera / "data" / found[time]).relative_to(folder).as_posix()
            pose = matrix @ tracked_from_camera if has else None
            pictures.append(PosedPicture(name, camera.name, time, lens, sensor, pose))
    return posed_capture(top, pictures, "seconds", dtype)


def _home(folder: Path) -> Path:
    return folder / _HOME if (folder / _HOME).is_dir() else folder


def _pictures(folder: Path) -> dict[float, str]:
    """The pictures of a camera by their times in seconds, in order."""
    inside = sorted(folder.iterdir()) if folder.is_dir() else []
    paths = [p for p in inside if p.suffix.lower() in KNOWN_SUFFIXES and p.stem.isdecimal()]
    times = [float(path.stem[:30]) * 1e-9 for path in paths]
    return by_time(folder, times, [path.name for path in paths])


def _sensor(path: Path) -> Keys:
    """The keys of a sensor.yaml."""
    if not path.is_file():
        raise CaptureError(f"{path}: is missing. It holds a camera's lens and its pose (T_BS).")
    if path.stat().st_size > _MOST_BYTES:
        raise CaptureError(f"{path}: must be at most {_MOST_BYTES:,} bytes, as a sensor's file is.")
    text = read_text(path).decode("utf-8-sig", "replace")
    # OpenCV begins a file with a line that is no YAML.
    text = text.replace("%YAML:1.0", "", 1)
    try:
        check_aliases(path, text)
        content = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise CaptureError(f"{path}: must be YAML, got {str(error)[:200]}.") from None
    if not isinstance(content, Mapping):
        raise CaptureError(f"{path}: must hold the keys of a sensor, such as T_BS and intrinsics.")
    return Keys(path, dict(content))


def _matrix(sensor: Keys) -> Float[np.ndarray, "4 4"]:
    """The matrix from a sensor to the body."""
    block = block_in(sensor, "T_BS")
    matrix = Keys(block.file, {"data": block.vector("data", 16)}, prefix=block.prefix).pose("data")
    return np.concatenate([matrix, [[0, 0, 0, 1]]])


def _lens(sensor: Keys) -> dict[str, Any]:
    """The keys of a camera's lens, as in a transforms.json."""
    sensor.choice("camera_model", ("pinhole",), "pinhole")
    numbers = sensor.vector("intrinsics", 4)
    if min(numbers[:2]) <= 0:
        raise sensor.error("intrinsics", "fx, fy, cx and cy in pixels, with fx and fy above 0")
    lens = lens_of_coefficients(numbers)
    if sensor.has("resolution"):
        size = Keys(sensor.file, dict(zip("wh", sensor.vector("resolution", 2), strict=True)))
        lens |= {"w": size.count("w"), "h": size.count("h")}
    kind = sensor.choice("distortion_model", tuple(_DISTORTIONS), "none")
    model, names = _DISTORTIONS[kind]
    if not names:
        return lens
    values = sensor.vector("distortion_coefficients", len(names))
    return {**lens, "camera_model": model, **dict(zip(names, values, strict=True))}
