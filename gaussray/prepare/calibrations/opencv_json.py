"""JSON files of scripts around OpenCV: K, R and t of each camera, under their usual names."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.known_camera import (
    Calibration,
    KnownCamera,
    check_name,
    opencv_camera,
)
from gaussray.prepare.errors import PrepareError


# Names of a camera's values, in small letters, and how many numbers each may have.
_MATRIX = ("k", "matrix", "camera_matrix", "intrinsics", "intrinsic", "mtx")
_ROTATION = ("r", "rotation", "rotation_matrix", "rvec")
_TRANSLATION = ("t", "translation", "tvec")
_DISTORTION = ("dist", "distortion", "distortions", "d", "dist_coeffs", "distcoef")
_SIZE = ("size", "resolution")
_NEEDED = {_MATRIX: (9,), _ROTATION: (3, 9), _TRANSLATION: (3,)}
# Keys of a list's cameras that hold their names.
_NAMES = ("name", "camera", "cam", "id", "camera_id", "serial")


def is_opencv_camera(content: Any) -> bool:
    """Whether the content of a JSON file, or a part of it, has a camera's K, R and t."""
    return isinstance(content, dict) and all(
        _numbers(content, names, *counts) is not None for names, counts in _NEEDED.items()
    )


def opencv_cameras(path: Path, content: Any) -> Calibration | None:
    """The cameras of a file, by the keys of an object or the names in a list; None if it has none.

    Each has a 3 x 3 matrix K, a rotation R (a matrix or a Rodrigues vector) and a translation t,
    which take world to camera (OpenCV), and may have distortion and size (columns and rows). One
    with K alone is left out.

    Args:
        path: the file, for messages.
        content: what it holds, at the top or under `cameras`.

    Raises:
        PrepareError: Numbers make no camera, two cameras have one name, or the file has one alone.
    """
    if is_opencv_camera(content):
        raise PrepareError(
            f"poses.calibration={path}: must hold all cameras, got one. If each has a file of its "
            f"own, called as its video, give their folder: poses.calibration={path.parent}."
        )
    if isinstance(content, dict) and isinstance(content.get("cameras"), dict | list):
        content = content["cameras"]
    if isinstance(content, dict):
        listed = list(content.items())
    elif isinstance(content, list):
        listed = [(_name(one), one) for one in content]
    else:
        return None
    found = [(name, one) for name, one in listed if name is not None and is_opencv_camera(one)]
    names = [str(name) for name, _ in found]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise PrepareError(
            f"{path}: each camera must have a name of its own, got {twice} twice. Change one."
        )
    left_out = {
        str(name): "has no R and t"
        for name, one in listed
        if isinstance(one, dict)
        and _numbers(one, _MATRIX, 9) is not None
        and str(name) not in names
    }
    cameras = [read_opencv_camera(path, name, one) for name, one in found]
    return Calibration(cameras, left_out) if cameras else None


def read_opencv_camera(path: Path, name: object, content: dict[str, Any]) -> KnownCamera:
    """The camera of a part of a file.

    Args:
        path: the file, for messages.
        name: name of the camera.
        content: its keys (`is_opencv_camera`).

    Raises:
        PrepareError: The numbers make no camera.
    """
    matrix, turn, translation = (
        _numbers(content, names, *counts) for names, counts in _NEEDED.items()
    )
    assert matrix is not None and turn is not None and translation is not None
    if len(turn) == 3:
        turn = Rotation.from_rotvec(turn).as_matrix()
    distortion = _numbers(content, _DISTORTION)
    given = [key for key, value in content.items() if str(key).lower() in _DISTORTION and value]
    if distortion is None and given:
        raise PrepareError(
            f"{path}: {given[0]} of camera {name} must be numbers (OpenCV's k1 k2 p1 p2 k3), got "
            f"{str(content[given[0]])[:80]}."
        )
    size = _numbers(content, _SIZE, 2)
    if size is None:
        sides = (_numbers(content, names, 1) for names in (("width", "w"), ("height", "h")))
        size = [0 if side is None else side[0] for side in sides]
    return opencv_camera(
        path,
        check_name(path, name),
        matrix.reshape(3, 3),
        np.zeros(4) if distortion is None else distortion,
        np.column_stack([turn.reshape(3, 3), translation]),
        (int(size[0]), int(size[1])),
    )


def _numbers(content: dict[str, Any], names: tuple[str, ...], *counts: int) -> np.ndarray | None:
    """The finite numbers under the first of some keys, whatever their case, that has so many;
    None if none does."""
    values = [value for key, value in content.items() if str(key).lower() in names]
    for value in values:
        try:
            numbers = np.array(value, np.float64).ravel()
        except (ValueError, TypeError, OverflowError):
            continue
        if np.isfinite(numbers).all() and (not counts or len(numbers) in counts):
            return numbers
    return None


def _name(camera: Any) -> Any:
    given = camera if isinstance(camera, dict) else {}
    found = (given[key] for key in _NAMES if isinstance(given.get(key), str | int))
    return next(found, None)
