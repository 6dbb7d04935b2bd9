"""Results of OpenCV's stereoCalibrate: two lenses, and the pose of the second camera.

A point x1 of the first camera's axes is x2 = R x1 + T in the second's; the first camera's axes are
the world's.
"""

import itertools
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.known_camera import Calibration, opencv_camera
from gaussray.prepare.calibrations.opencv_numbers import (
    DISTORTION_COUNTS,
    checked_rotation,
    finite_numbers,
    plain_value,
)
from gaussray.prepare.calibrations.picture_sizes import sides_in
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError
from gaussray.runtime.progress import say


# What the two cameras of a pair are called.
PAIR_NAMES = ("left", "right")
# Names of both cameras in keys, before or behind the name of a value: mtxL, left_K, dist_1.
_SIDES = (PAIR_NAMES, ("l", "r"), ("1", "2"), ("0", "1"))
# How many numbers each value may have: a rotation may be OpenCV's rotation vector.
_COUNTS = {"matrix": (9,), "distortion": DISTORTION_COUNTS, "rotation": (9, 3), "translation": (3,)}
# Keys of the two cameras that messages name.
_EXAMPLES = {
    "matrix": "camera matrices (M1 and M2, K1 and K2, mtxL and mtxR, cameraMatrix1 and ...)",
    "distortion": "distortion coefficients (D1 and D2, distL and distR, distCoeffs1 and ...)",
    "rotation": "the rotation R from the first camera to the second",
    "translation": "the translation T from the first camera to the second",
}
_REMEDY = (
    "Save all of cv2.stereoCalibrate's results (as K1, D1, K2, D2, R and T), unchanged. The keys "
    "R1, R2, P1, P2 and Q of a rectification do not replace them."
)


class _Found(NamedTuple):
    """The numbers of a value and the key that they are under."""

    key: str
    numbers: np.ndarray


def has_stereo_pose(keys: Iterable[str]) -> bool:
    """Whether keys name a rotation and a translation between two cameras, of no camera alone."""
    plain = {plain_key(key) for key in keys}
    return all(plain & set(VALUE_NAMES[what]) for what in ("rotation", "translation"))


def has_stereo_lenses(keys: Iterable[str]) -> bool:
    """Whether keys name the camera matrices of two cameras."""
    plain = {plain_key(key) for key in keys}
    return any(
        all(plain & _of_side("matrix", side) for side in sides)  # both cameras
        for sides in _SIDES
    )


def is_stereo_calibration(values: Mapping[str, Any]) -> bool:
    """Whether the values of a JSON or YAML file have two matrices (K1 is one, k1 a coefficient) and
    a pose between their cameras."""
    plain = {str(key): np.array(plain_value(value), object) for key, value in values.items()}
    matrices = [key for key, value in plain.items() if np.size(value) == 9]
    return has_stereo_lenses(matrices) and has_stereo_pose(map(str, values))


def stereo_cameras(where: object, values: Mapping[str, Any], *, name: str = "") -> Calibration:
    """The two cameras of a stereo calibration, called left (the first) and right.

    Args:
        where: the file or files that messages name.
        values: what the file holds by key; what is not of the calibration is ignored.
        name: the file's name. With `fisheye` in it, four distortion coefficients are k1 to k4 of
            OpenCV's fisheye model, instead of k1, k2, p1, p2.

    Raises:
        PrepareError: A value is missing, has other numbers or is under two keys with different
            numbers; R is no rotation; T is zero; or the numbers make no camera.
    """
    matrices = _of_both(where, values, "matrix")
    distortions = _of_both(where, values, "distortion")
    turn, shift = (_single(where, values, what) for what in ("rotation", "translation"))
    if not np.any(shift.numbers):
        raise PrepareError(
            f"{where}: {shift.key} must not be zero, because cameras at one place have no "
            f"parallax. {_REMEDY}"
        )
    try:
        if len(turn.numbers) == 3:
            rotation = Rotation.from_rotvec(turn.numbers).as_matrix()
        else:
            rotation = checked_rotation(turn.numbers)
    except ValueError as error:
        raise PrepareError(f"{where}: {turn.key} {error}. {_REMEDY}") from None
    poses = (np.eye(3, 4), np.column_stack([rotation, shift.numbers]))
    fisheye = "fisheye" in name.lower() and any(len(d.numbers) == 4 for d in distortions)
    if fisheye:
        if any(len(d.numbers) != 4 for d in distortions):
            raise PrepareError(
                f"{where}: {distortions[0].key} and {distortions[1].key} must be four numbers each "
                "of OpenCV's fisheye model, which the file's name says, or none of them. Rename "
                "the file if the lenses are no fisheyes."
            )
        say(f"{where}: four distortion coefficients are taken as OpenCV's fisheye model.")
    size = _size(values)
    cameras = [
        opencv_camera(
            where,
            name,
            matrix.numbers.reshape(3, 3),
            distortion.numbers,
            pose,
            size,
            fisheye=fisheye,
        )
        for name, matrix, distortion, pose in zip(
            PAIR_NAMES, matrices, distortions, poses, strict=True
        )
    ]
    return Calibration(cameras, is_pair=True)


def _of_side(what: str, side: str) -> set[str]:
    """The plain keys of a value of one camera."""
    names = VALUE_NAMES[what]
    return {name + side for name in names} | {side + name for name in names}


def _of_both(where: object, values: Mapping[str, Any], what: str) -> tuple[_Found, _Found]:
    """A value of both cameras."""
    pairs: list[tuple[_Found, _Found]] = []
    alone: list[str] = []
    for sides in _SIDES:
        keys = [_keys(values, _of_side(what, side)) for side in sides]
        if all(keys):
            first, second = (_agreed(where, values, what, own) for own in keys)
            pairs.append((first, second))
        alone += [*keys[0], *keys[1]]
    if not pairs:
        one = f"{alone[0]} of one camera alone" if alone else _listed(values)
        raise PrepareError(f"{where}: must hold two {_EXAMPLES[what]}, got {one}. {_REMEDY}")
    for one, two in itertools.pairwise(pairs):
        if not all(np.array_equal(a.numbers, b.numbers) for a, b in zip(one, two, strict=True)):
            raise PrepareError(
                f"{where}: must hold two {_EXAMPLES[what]}, got {one[0].key} and {one[1].key}, and "
                f"other numbers as {two[0].key} and {two[1].key}. Keep those of R and T alone."
            )
    return pairs[0]


def _single(where: object, values: Mapping[str, Any], what: str) -> _Found:
    """A value that the file has once."""
    keys = _keys(values, set(VALUE_NAMES[what]))
    if not keys:
        raise PrepareError(
            f"{where}: must hold {_EXAMPLES[what]}, got {_listed(values)}. {_REMEDY}"
        )
    return _agreed(where, values, what, keys)


def _keys(values: Mapping[str, Any], plain: set[str]) -> list[str]:
    return [key for key in values if plain_key(key) in plain]


def _agreed(where: object, values: Mapping[str, Any], what: str, keys: list[str]) -> _Found:
    """The numbers under keys of one meaning, of which those with other counts are another thing
    (K1 is a camera matrix, k1 a coefficient)."""
    found: list[_Found] = []
    complaint = ""
    for key in keys:
        try:
            found.append(_Found(key, finite_numbers(values[key], _COUNTS[what])))
        except ValueError as error:
            complaint = complaint or f"{key} {error}"
    if not found:
        raise PrepareError(f"{where}: {complaint}. {_REMEDY}")
    for other in found[1:]:
        if not np.array_equal(other.numbers, found[0].numbers):
            raise PrepareError(
                f"{where}: {found[0].key} and {other.key} must not differ, because both are the "
                f"{what}. Keep one of them."
            )
    return found[0]


def _listed(values: Mapping[str, Any]) -> str:
    return (", ".join(map(str, values)) or "no keys")[:200]


def _size(values: Mapping[str, Any]) -> tuple[float, float]:
    """Columns and rows of the calibrated pictures; 0 if the file does not say them."""
    for key in _keys(values, set(VALUE_NAMES["size"])):
        try:
            columns, rows = finite_numbers(values[key], (2,))
        except ValueError:
            continue
        return float(columns), float(rows)
    return sides_in(values)
