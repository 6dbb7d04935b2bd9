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
    refuse_distortion,
)
from gaussray.prepare.errors import PrepareError


# Names of a camera's values, in small letters, and how many numbers each may have.
_MATRIX = ("k", "matrix", "camera_matrix", "intrinsics", "intrinsic", "mtx")
_ROTATION = ("r", "rotation", "rotation_matrix", "rvec")
_TRANSLATION = ("t", "translation", "tvec")
_DISTORTION = (
    *("d", "dist", "distortion", "distortions", "distortion_coefficients"),
    *("dist_coef", "dist_coefs", "dist_coeffs", "distcoef", "distcoefs", "distcoeffs"),
)
_SIZE = ("size", "resolution")
_SIDES = (("width", "w"), ("height", "h"))
_NEEDED = {_MATRIX: (9,), _ROTATION: (3, 9), _TRANSLATION: (3,)}
# Keys of a list's cameras that hold their names.
CAMERA_NAME_KEYS = ("name", "camera", "cam", "id", "camera_id", "serial")
# What is said of a camera without a pose, after its name.
_NO_POSE = "has no R (3 or 9 numbers) and t (3 numbers)"
_POSE_REMEDY = "Both take world to camera; R is a matrix or a rotation vector."


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
        PrepareError: Numbers make no camera, no camera has a pose, two have one name or one of a
            list has none, or the file has one camera alone.
    """
    if is_opencv_camera(content):
        raise PrepareError(
            f"poses.calibration={path}: must hold all cameras, got one. If each has a file of its "
            f"own, called as its video, give their folder: poses.calibration={path.parent}."
        )
    if isinstance(content, dict) and isinstance(content.get("cameras"), dict | list):
        content = content["cameras"]
    if _has_matrix(content):
        raise PrepareError(f"{path}: the camera {_NO_POSE}. {_POSE_REMEDY}")
    listed = _listed(path, content)
    found = {name: one for name, one in listed.items() if is_opencv_camera(one)}
    left_out = {name: _NO_POSE for name in listed if name not in found}
    if left_out and not found:
        raise PrepareError(
            f"{path}: must have a camera with a pose, got none: camera {next(iter(left_out))} "
            f"{_NO_POSE}. {_POSE_REMEDY}"
        )
    cameras = [read_opencv_camera(path, name, one) for name, one in found.items()]
    return Calibration(cameras, left_out) if cameras else None


def _listed(path: Path, content: Any) -> dict[str, dict[str, Any]]:
    """The parts of a file that have a camera's matrix, by the camera's name."""
    if isinstance(content, dict):
        return {str(name): one for name, one in content.items() if _has_matrix(one)}
    result: dict[str, dict[str, Any]] = {}
    for number, one in enumerate(content if isinstance(content, list) else [], 1):
        if not _has_matrix(one):
            continue
        name = said_name(one)
        if name is None:
            raise PrepareError(
                f"{path}: camera {number} of the list must have a name "
                f"({', '.join(CAMERA_NAME_KEYS)}), got none. Give each the name of its video."
            )
        if name in result:
            raise PrepareError(
                f"{path}: each camera must have a name of its own, got {name} twice. Change one."
            )
        result[name] = one
    return result


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
    unread = [key for key in content if str(key).lower() not in _DISTORTION]
    refuse_distortion(path, name, unread)
    return opencv_camera(
        path,
        check_name(path, name),
        matrix.reshape(3, 3),
        np.zeros(4) if distortion is None else distortion,
        np.column_stack([turn.reshape(3, 3), translation]),
        _size(path, name, content),
    )


def _size(path: Path, name: object, content: dict[str, Any]) -> tuple[float, float]:
    """Columns and rows; 0 if the camera does not say them."""
    keys = (*_SIZE, *_SIDES[0], *_SIDES[1])
    given = {key: content[key] for key in content if str(key).lower() in keys}
    if all(value is None for value in given.values()):
        return 0.0, 0.0
    size = _numbers(content, _SIZE, 2)
    if size is None:
        sides = [_numbers(content, names, 1) for names in _SIDES]
        size = [0.0 if side is None else float(side[0]) for side in sides]
    if not any(size):
        raise PrepareError(
            f"{path}: the size of camera {name} must be two whole numbers (columns and rows), got "
            f"{str(given)[:80]}. Correct or remove it."
        )
    return float(size[0]), float(size[1])


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


def _has_matrix(content: Any) -> bool:
    return isinstance(content, dict) and _numbers(content, _MATRIX, 9) is not None


def said_name(camera: dict[str, Any]) -> str | None:
    """The name of a camera of a list; None if it has none. A truth value is none."""
    found = (camera[key] for key in CAMERA_NAME_KEYS if type(camera.get(key)) in (str, int))
    return next(map(str, found), None)
