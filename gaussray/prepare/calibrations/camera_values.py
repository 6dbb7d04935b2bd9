"""The values of one camera under the names that all readers know.

Files have them in blocks (`intrinsics` and `extrinsics`), focal lengths apart (fx fy cx cy), or one
projection matrix for all.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from gaussray.prepare.calibrations.distortions import (
    OPENCV_ORDER,
    distortion_in,
    distortions_in,
    overruled_coefficients,
)
from gaussray.prepare.calibrations.opencv_numbers import (
    agreed_numbers,
    finite_numbers,
    numbers_under,
    plain_value,
)
from gaussray.prepare.calibrations.opencv_pose import POSE_NAMES, found_pose, say_poses
from gaussray.prepare.calibrations.projections import (
    SkewedProjection,
    refuse_skewed,
    skew_cost,
    split_projection,
)
from gaussray.prepare.calibrations.value_names import PROJECTION_NAMES, VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError
from gaussray.runtime.output import first_of
from gaussray.runtime.progress import say


# Blocks of a camera's values, and what their keys of other meanings elsewhere stand for.
_LENS = {"matrix": "intrinsics", "model": "camera_model"}
_BLOCKS = {
    **dict.fromkeys(("intrinsic", "intrinsics", "intrinsicparameters", "intrinsicparams"), _LENS),
    **dict.fromkeys(
        ("extrinsic", "extrinsics", "extrinsicparameters", "extrinsicparams"),
        {"matrix": "extrinsics"},
    ),
    **dict.fromkeys(VALUE_NAMES["distortion"], {"model": "distortion_model"}),
}
# Focal lengths and principal point under keys of their own.
_APART = ("fx", "fy", "cx", "cy")
_OTHER_APART = {"ppx": "cx", "ppy": "cy"}
# Those beside a matrix may be rounded: they differ from it by at most so many pixels, or this part.
_ROUNDED, _ROUNDED_PART = 1.0, 1e-3
_KNOWN = {
    *(name for names in VALUE_NAMES.values() for name in names),
    *(*POSE_NAMES, *PROJECTION_NAMES, *OPENCV_ORDER, *_APART, *_OTHER_APART),
}


def plain_camera(where: object, values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a camera without blocks, with K (3 x 3) for four focal numbers, and with K and
    [R | t] for a projection.

    Args:
        where: the file, and the camera in it, for messages.
        values: values by key, which may be of another thing.

    Raises:
        SkewedProjection: A projection has skew that cannot be left out.
        PrepareError: Two values of one meaning differ, fx fy cx cy are not complete, or a
            projection is of no camera.
    """
    result: dict[str, Any] = {}
    for key, value in values.items():
        renamed = _BLOCKS.get(plain_key(key)) if _is_block(key, value) else None
        if renamed is None:
            _put(where, result, key, value)
            continue
        for inner, one in value.items():
            _put(where, result, renamed.get(plain_key(inner), str(inner)), one)
    for key in [key for key in result if plain_key(key) in VALUE_NAMES["matrix"]]:
        if (four := numbers_under({key: result[key]}, VALUE_NAMES["matrix"], (4,))) is not None:
            result[key] = _matrix(four[1])
    if (focal := _focal_numbers(where, result)) is not None:
        _add_matrix(where, result, focal)
    elif not has_matrix(result):
        projection = numbers_under(result, PROJECTION_NAMES, (12, 16))
        if projection is not None and found_pose(result) is None:
            result["K"], result["[R | t]"] = split_projection(str(where), *projection)
    return result


def plain_cameras(
    cameras: Mapping[str, tuple[object, Mapping[str, Any]]],
) -> dict[str, dict[str, Any]]:
    """The values of several cameras (`plain_camera`) by their names. What is said of projections
    with skew is said of all of them at once.

    Args:
        cameras: for each, the file and the camera in it, for messages, and its values.

    Raises:
        PrepareError: As `plain_camera` says.
    """
    result: dict[str, dict[str, Any]] = {}
    skewed: list[tuple[str, SkewedProjection]] = []
    for name, (where, values) in cameras.items():
        try:
            result[name] = plain_camera(where, values)
        except SkewedProjection as error:
            skewed.append((name, error))
    if skewed:
        refuse_skewed(skewed)
    return result


def _is_block(key: object, value: Any) -> bool:
    """Whether a value is an object of values: no matrix, and no camera, which may be called d."""
    if not isinstance(value, Mapping) or "data" in value:
        return False
    lens, pose = _has_lens(value), found_pose(value) is not None
    if plain_key(key) in VALUE_NAMES["distortion"]:
        return not lens and not pose and bool(distortions_in(value))
    return not (lens and pose)


def _has_lens(value: Any) -> bool:
    """Whether a value is an object with a matrix, focal lengths or a projection of its own."""
    return isinstance(value, Mapping) and (
        has_matrix(value)
        or {"fx", "fy"} <= set(map(plain_key, value))
        or numbers_under(value, PROJECTION_NAMES, (12, 16)) is not None
    )


def has_matrix(camera: Any) -> bool:
    """Whether values are of a camera with a matrix.

    Args:
        camera: values by key (`plain_camera`), or another thing.
    """
    return (
        isinstance(camera, Mapping)
        and numbers_under(camera, VALUE_NAMES["matrix"], (9,)) is not None
    )


def tell_readings(where: object, cameras: Sequence[Mapping[str, Any]]) -> None:
    """Print how the values of a file's cameras are taken: the way of their poses, projections, and
    one or two distortion coefficients.

    Args:
        where: the file or folder.
        cameras: values of each camera that is read (`plain_camera`).
    """
    split = [camera for camera in cameras if "[R | t]" in camera and _projection_key(camera)]
    own = [camera for camera in cameras if not any(camera is one for one in split)]
    say_poses(where, filter(None, map(found_pose, own)))
    if split:
        cost = max(map(_skew_cost, split))
        left = f" Skew is left out, which costs at most {cost:.2g} pixels at the border."
        left = left if cost > 1e-3 else ""
        say(
            f"{where}: {_projection_key(split[0])} is split into K and [R | t], with positive "
            f"focal lengths; the middle of the first pixel is at 0, 0.{left}"
        )
    tell_few_coefficients(where, cameras)


def tell_few_coefficients(where: object, cameras: Iterable[Mapping[str, Any]]) -> None:
    """Print how one or two distortion coefficients are taken, and what is not used, because the
    matrix or the list of coefficients says the same with more digits.

    Args:
        where: the file or folder.
        cameras: values of each camera that is read (`plain_camera`).
    """
    cameras = list(cameras)
    counts = {len(distortion_in(str(where), camera)) for camera in cameras}
    overruled = [key for camera in cameras for key in _overruled(where, camera)]
    if overruled:
        say(
            f"{where}: {first_of(list(dict.fromkeys(overruled)))} beside the matrix or the list of "
            "coefficients differ from it, or are not read; the matrix and the list are taken."
        )
    if 1 in counts:
        say(f"{where}: a single distortion coefficient is taken as k1; the others are 0.")
    if 2 in counts:
        say(f"{where}: two distortion coefficients are taken as k1 and k2; the others are 0.")


def _skew_cost(camera: Mapping[str, Any]) -> float:
    """Pixels that it cost to leave out the skew of a camera's projection."""
    found = numbers_under(camera, PROJECTION_NAMES, (12, 16))
    return 0.0 if found is None else skew_cost(found[1])


def _projection_key(camera: Mapping[str, Any]) -> str:
    return next((str(key) for key in camera if plain_key(key) in PROJECTION_NAMES), "")


def _overruled(where: object, camera: Mapping[str, Any]) -> list[str]:
    """Keys of rounded values beside the matrix or the list of coefficients, which are taken."""
    focal, found = _focal_numbers(where, camera), overruled_coefficients(str(where), camera)
    matrix = numbers_under(camera, VALUE_NAMES["matrix"], (9,))
    if focal is None or matrix is None or np.allclose(focal.ravel(), matrix[1], rtol=1e-9):
        return found
    names = (*_APART, *_OTHER_APART, "skew")
    return [*(str(key) for key in camera if plain_key(key) in names), *found]


def _put(where: object, values: dict[str, Any], key: str, value: Any) -> None:
    """Add a value; refuse another one under the same key if it has a meaning."""
    if key in values and str(values[key]) != str(value) and plain_key(key) in _KNOWN:
        raise PrepareError(
            f"{where}: {key} must be there once, got {str(values[key])[:80]} and "
            f"{str(value)[:80]}. Keep one of them."
        )
    values.setdefault(key, value)


def _add_matrix(where: object, values: dict[str, Any], matrix: np.ndarray) -> None:
    """Add the matrix of fx fy cx cy; refuse it if there is another one, but for rounding."""
    if not has_matrix(values):
        values["K"] = matrix
        return
    said = agreed_numbers(str(where), values, "matrix", (9,)).reshape(3, 3)
    if not np.all(np.abs(said - matrix) <= np.maximum(_ROUNDED, _ROUNDED_PART * np.abs(said))):
        raise PrepareError(
            f"{where}: fx, fy, cx and cy must not differ from the matrix {said.tolist()}, got "
            f"{matrix.tolist()}. Keep one of them."
        )


def _focal_numbers(where: object, values: Mapping[str, Any]) -> np.ndarray | None:
    """The matrix of focal lengths and principal point under keys of their own."""
    found: dict[str, float] = {}
    for key, value in values.items():
        name = _OTHER_APART.get(plain_key(key), plain_key(key))
        if name not in (*_APART, "skew"):
            continue
        try:
            found[name] = float(finite_numbers(plain_value(value), (1,))[0])
        except ValueError:
            continue
    if not {"fx", "fy"} & found.keys():
        return None
    if missing := [name for name in _APART if name not in found]:
        if has_matrix(values):
            return None
        raise PrepareError(
            f"{where}: must have fx, fy, cx and cy as numbers, got no {', '.join(missing)}. Add "
            "what is missing, in pixels."
        )
    matrix = _matrix(np.array([found[name] for name in _APART]))
    matrix[0, 1] = found.get("skew", 0.0)
    return matrix


def _matrix(four: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy = four
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
