"""A file for each camera, JSON or OpenCV's, in a folder or each in a folder of its own."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gaussray.capture.formats.transforms import json_if_readable
from gaussray.prepare.calibrations.known_camera import Calibration
from gaussray.prepare.calibrations.opencv_json import is_opencv_camera, read_opencv_camera
from gaussray.prepare.calibrations.opencv_pose import found_pose, say_poses
from gaussray.prepare.calibrations.opencv_storage import is_small_storage, storage_values
from gaussray.prepare.calibrations.stereo_pair import has_stereo_lenses
from gaussray.prepare.errors import PrepareError


def is_camera_file(path: Path) -> bool:
    """Whether a file holds one camera with its pose, and nothing of others."""
    return bool(_values(path))


def files_by_stem(files: Sequence[Path]) -> dict[str, Path]:
    """Files of one camera each by their names without suffix.

    Raises:
        PrepareError: Two have one name.
    """
    result: dict[str, Path] = {}
    for path in files:
        if path.stem in result:
            raise PrepareError(
                f"poses.calibration={path.parent}: the folder must hold one file for each camera, "
                f"got {result[path.stem].name} and {path.name}. Take one of them away."
            )
        result[path.stem] = path
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
    values = {name: _values(path) for name, path in files.items()}
    cameras = [read_opencv_camera(files[name], name, one) for name, one in values.items()]
    say_poses(where, filter(None, map(found_pose, values.values())))
    return Calibration(cameras)


def _values(path: Path) -> dict[str, Any]:
    """The values of the one camera of a file; empty if it is no such file."""
    found: Any = None
    try:
        if path.suffix.lower() == ".json":
            found = json_if_readable(path)
        elif is_small_storage(path):
            found = storage_values(path)
    except (PrepareError, OSError, ValueError):
        return {}
    return found if is_opencv_camera(found) and not has_stereo_lenses(found) else {}
