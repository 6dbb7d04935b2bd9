"""A file for each camera (JSON, YAML, text, OpenCV's or Tsai's), in a folder or one for each."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gaussray.capture.formats.transforms import json_if_readable
from gaussray.prepare.calibrations.camera_text import is_camera_text, text_cameras
from gaussray.prepare.calibrations.camera_values import (
    plain_camera,
    plain_cameras,
    tell_readings,
)
from gaussray.prepare.calibrations.dlt_facing import check_dlts
from gaussray.prepare.calibrations.known_camera import Calibration
from gaussray.prepare.calibrations.named_cameras import is_by_value
from gaussray.prepare.calibrations.opencv_json import is_opencv_camera, read_opencv_camera
from gaussray.prepare.calibrations.opencv_numbers import numbers_under
from gaussray.prepare.calibrations.opencv_pose import found_pose
from gaussray.prepare.calibrations.opencv_storage import is_small_storage, storage_values
from gaussray.prepare.calibrations.stereo_pair import is_stereo_calibration
from gaussray.prepare.calibrations.tsai import is_tsai, read_tsai, tell_tsai
from gaussray.prepare.calibrations.value_names import DLT_KEY, PROJECTION_NAMES
from gaussray.prepare.calibrations.yaml_file import yaml_content
from gaussray.prepare.errors import PrepareError


def is_camera_file(path: Path) -> bool:
    """Whether a file holds one camera with its pose, and nothing of others.

    Nothing is refused here: a camera whose values contradict each other is one, and any other file
    is none.
    """
    if is_tsai(path):
        return True
    found = _content(path)
    try:
        return is_opencv_camera(plain_camera(path, found))
    except PrepareError:
        inner = [found, *(value for value in found.values() if isinstance(value, Mapping))]
        return any(
            found_pose(values) is not None or numbers_under(values, PROJECTION_NAMES, (12, 16))
            for values in inner
        )


def files_by_stem(files: Sequence[Path]) -> dict[str, Path]:
    """Files of one camera each by their names without suffix (`00_P.txt` is of 00).

    Raises:
        PrepareError: Two have one name.
    """
    result: dict[str, Path] = {}
    for path in files:
        name = re.sub("(?<=.)_P$", "", path.stem) if path.suffix.lower() == ".txt" else path.stem
        if name in result:
            raise PrepareError(
                f"poses.calibration={path.parent}: the folder must hold one file for each camera, "
                f"got {result[name].name} and {path.name}. Take one of them away."
            )
        result[name] = path
    return result


def files_of_subfolders(folder: Path) -> dict[str, Path]:
    """The file of one camera in each folder inside a folder, by the name of the former; those
    without one are passed over.

    Raises:
        PrepareError: A folder has several.
    """
    result: dict[str, Path] = {}
    for inside in sorted(path for path in folder.iterdir() if path.is_dir()):
        files = [path for path in sorted(inside.iterdir()) if is_camera_file(path)]
        if len(files) > 1:
            raise PrepareError(
                f"poses.calibration={folder}: each folder inside must hold the file of one camera, "
                f"got {', '.join(path.name for path in files[:9])} in {inside.name}. Take away all "
                "but one."
            )
        if files:
            result[inside.name] = files[0]
    return result


def read_camera_files(where: str, files: Mapping[str, Path]) -> Calibration:
    """The cameras of files of one camera each, and a line that tells which way their poses are.

    Args:
        where: what the line names.
        files: each file (`is_camera_file`) by its camera's name.

    Raises:
        PrepareError: The numbers of a file make no camera.
    """
    tsai = {name: read_tsai(path, name) for name, path in files.items() if is_tsai(path)}
    others = {name: path for name, path in files.items() if name not in tsai}
    values = plain_cameras({name: (path, _content(path)) for name, path in others.items()})
    cameras = [
        tsai[name].camera if name in tsai else read_opencv_camera(path, name, values[name])
        for name, path in files.items()
    ]
    of_dlts = [camera.pose for camera in cameras if DLT_KEY in values.get(camera.name, {})]
    check_dlts(where, of_dlts)
    tell_tsai(where, tsai)
    tell_readings(where, list(values.values()))
    return Calibration(cameras)


def _content(path: Path) -> dict[str, Any]:
    """What a file that may be of one camera holds; empty if it is no such file."""
    found: Any = None
    try:
        if path.suffix.lower() == ".json":
            found = json_if_readable(path)
        elif is_small_storage(path):
            found = storage_values(path)
        elif path.suffix.lower() in (".yaml", ".yml"):
            found = yaml_content(path)
        elif is_camera_text(path):
            found = text_cameras(path).alone
        if not isinstance(found, dict) or is_by_value(found) or is_stereo_calibration(found):
            return {}
    except (PrepareError, OSError, ValueError):
        return {}
    return found
