"""NumPy's .npz files with one array of each value, of all cameras: K [N, 3, 3], R, T, dist; or
projections [N, 3, 4], which may be one array for each camera."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.prepare.calibrations.known_camera import Calibration
from gaussray.prepare.calibrations.lens_labels import MODEL_LABELS, labels_in
from gaussray.prepare.calibrations.opencv_json import opencv_cameras
from gaussray.prepare.calibrations.value_names import PROJECTION_NAMES, VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError
from gaussray.runtime.progress import say


# Names of the array of the cameras' names.
_NAMES = ("names", "cameras", "cameranames", "camnames", "cams", "ids", "cameraids", "serials")
# Names of arrays of one number or text for each camera.
_SINGLE = (*VALUE_NAMES["width"], *VALUE_NAMES["height"], *MODEL_LABELS)
# Names of poses that are of cameras in these files alone: cv2.calibrateCamera calls so the poses
# of its views of one camera.
_POSES = {"rvecs": "rvec", "tvecs": "tvec"}
# Projections of one camera each, and what a rectification has beside them.
_OF_ONE = re.compile(
    r"(?:projection_matrix|proj_?mat(?:rix)?|projection|proj|p)(?:_(\w+)|(\d+))", re.I
)
_PROJECTIONS = ((3, 4), (4, 4))
_RECTIFICATION = {"r1", "r2", "q"}
_REMEDY_P = "If they have others, save them with it: names=['cam1', 'cam2']."
_REMEDY = (
    "Save them with it, in the order of the arrays: numpy.savez(FILE, names=['cam1', 'cam2'], "
    "K=K, R=R, T=T, dist=dist)."
)


def camera_stack(values: Mapping[str, np.ndarray]) -> str | None:
    """The key of an array of several cameras' matrices [N, 3, 3], else of their projections
    [N, 3, 4] or [N, 4, 4]; None if there is none.

    Args:
        values: arrays by key.
    """
    for names, shapes in ((VALUE_NAMES["matrix"], ((3, 3),)), (PROJECTION_NAMES, _PROJECTIONS)):
        for key in (key for key in values if plain_key(key) in names):
            if values[key].ndim == 3 and values[key].shape[1:] in shapes:
                return key
    return None


def with_stacked_projections(path: Path, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of a file, those of projections of one camera each (`P1`, `proj_left`) as one
    array with the cameras' names.

    Args:
        path: the file, for messages.
        values: arrays by key.

    Raises:
        PrepareError: Two of them are of one camera.
    """
    found: dict[str, tuple[str, np.ndarray]] = {}
    twice = ""
    for key in values:
        match = _OF_ONE.fullmatch(key)
        if match is None or values[key].shape not in _PROJECTIONS:
            continue
        name = match[1] or match[2]
        if name in found:
            twice = f"{found[name][0]} and {key}, which are both of camera {name}"
        found.setdefault(name, (key, values[key]))
    shapes = {value.shape for _, value in found.values()}
    plain = {plain_key(key) for key in values}
    if len(found) < 2 or len(shapes) > 1 or plain & _RECTIFICATION or camera_stack(values):
        return dict(values)
    if twice:
        raise PrepareError(
            f"{path}: must hold one projection of each camera, got {twice}. Remove or rename one."
        )
    ordered = sorted(found, key=lambda name: name.zfill(9) if name.isdecimal() else name)
    kept = {key: values[key] for key in values if key not in {key for key, _ in found.values()}}
    return kept | {"P": np.array([found[name][1] for name in ordered]), "names": np.array(ordered)}


def has_camera_names(values: Mapping[str, np.ndarray]) -> bool:
    """Whether a file says the names of its cameras.

    Args:
        values: arrays by key.
    """
    return any(plain_key(key) in _NAMES for key in values)


def stacked_cameras(path: Path, values: Mapping[str, np.ndarray]) -> Calibration:
    """The cameras of a file whose arrays have one entry for each; other arrays count for all. They
    are fisheyes if the file says so, or has `fisheye` in its name and four distortion coefficients.

    Args:
        path: the file, for messages.
        values: its arrays by key (`camera_stack`).

    Raises:
        PrepareError: There is no array of as many names, or numbers make no camera.
    """
    key = camera_stack(values)
    assert key is not None
    count = len(values[key])
    values = {key: _decoded(value) for key, value in values.items()}
    names = next((values[key] for key in values if plain_key(key) in _NAMES), None)
    if names is None and plain_key(key) in PROJECTION_NAMES:
        names = np.arange(count)
        say(f"{path}: the {count} cameras are called by their place in {key}, from 0. {_REMEDY_P}")
    names = np.zeros(0) if names is None else names
    if names.shape != (count,) or names.dtype.kind not in "iuU":
        raise PrepareError(
            f"{path}: must hold the names of its {count} cameras as names, got "
            f"{', '.join(values)[:200]}. {_REMEDY}"
        )
    shape = " x ".join(map(str, values[key].shape[1:]))
    if not count or values[key].dtype.kind not in "fiu" or not np.isfinite(values[key]).all():
        raise PrepareError(
            f"{path}: {key} must be finite numbers, {shape} for each camera, got "
            f"{str(values[key].tolist())[:80]}. Calibrate it again."
        )
    arrays = {
        key: value
        for key, value in values.items()
        if plain_key(key) in _SINGLE or (value.ndim and plain_key(key) not in _NAMES)
    }
    for key in [key for key in arrays if plain_key(key) in _POSES]:
        arrays.setdefault(_POSES[plain_key(key)], arrays.pop(key))
    _check_single(path, arrays, count)
    _check_rotations(path, arrays, count)
    parts = [{key: _own(key, one, k, count) for key, one in arrays.items()} for k in range(count)]
    if "fisheye" in path.name.lower() and not labels_in(arrays) and _has_four(parts[0]):
        say(f"{path}: four distortion coefficients are taken as OpenCV's fisheye model.")
        parts = [{**part, "fisheye": True} for part in parts]
    listed = [{"name": str(name), **one} for name, one in zip(names, parts, strict=True)]
    cameras = opencv_cameras(path, listed)
    assert cameras is not None
    return cameras


def _decoded(value: np.ndarray) -> np.ndarray:
    """An array, as text if it is of bytes."""
    return np.char.decode(value, "utf-8", "replace") if value.dtype.kind == "S" else value


def _check_single(path: Path, arrays: Mapping[str, np.ndarray], count: int) -> None:
    """Refuse numbers and texts of single cameras that are neither one for all nor one for each."""
    for key, value in arrays.items():
        if plain_key(key) in _SINGLE and value.size not in (1, count):
            raise PrepareError(
                f"{path}: {key} must be one value, or one for each of the {count} cameras, got "
                f"{value.size}. Correct or remove it."
            )


def _check_rotations(path: Path, arrays: Mapping[str, np.ndarray], count: int) -> None:
    """Refuse one 3 x 3 matrix R beside three cameras, which may be a vector of each as well."""
    for key, value in arrays.items():
        if plain_key(key) in VALUE_NAMES["rotation"] and count == 3 and value.shape == (3, 3):
            raise PrepareError(
                f"{path}: {key} must be 3 x 3 for each of the 3 cameras, got 3 x 3 once, which may "
                "be the rotation of all or a rotation vector of each. Write 3 x 3 x 3, or call "
                "vectors rvecs."
            )


def _own(key: str, value: np.ndarray, k: int, count: int) -> Any:
    """The entry of camera `k` in an array that has one for each camera; else all of it."""
    if plain_key(key) in _SINGLE:
        return value.ravel()[k if value.size == count else 0].item()
    return value[k] if len(value) == count and value[0].size > 1 else value


def _has_four(camera: Mapping[str, Any]) -> bool:
    """Whether a camera has four distortion coefficients."""
    found = [value for key, value in camera.items() if plain_key(key) in VALUE_NAMES["distortion"]]
    return any(np.size(value) == 4 for value in found)
