"""The lens of one camera from the values that programs around OpenCV write, without a pose."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from gaussray.prepare.calibrations.known_camera import opencv_camera, refuse_distortion
from gaussray.prepare.calibrations.lens_labels import DISTORTION_MODELS, is_fisheye
from gaussray.prepare.calibrations.opencv_numbers import DISTORTION_COUNTS, finite_numbers
from gaussray.prepare.calibrations.picture_sizes import sides_in
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.lens_models import LensKeyValues


# How many numbers the values of one camera may have: of a matrix, Kalibr and EuRoC write its focal
# lengths and principal point alone.
_COUNTS = {"matrix": (9, 4), "distortion": DISTORTION_COUNTS, "size": (2,)}
# Keys of distortion that is not one list of OpenCV's coefficients.
_APART = re.compile(r"k[1-6]|p[12]|radial.*|tangential.*|.*coef.*")


def has_camera_matrix(values: Any) -> bool:
    """Whether the values of a file, or of a part of it, are of one camera with a matrix."""
    return isinstance(values, Mapping) and len(_found("", values, "matrix", told=False)) > 0


def lens_of_values(where: str, values: Mapping[str, Any], *, name: str = "") -> LensKeyValues:
    """The lens of a camera: its matrix (or fx fy cx cy), distortion, size and model, under the
    names that OpenCV's users, ROS, Kalibr, EuRoC, Pose2Sim and Anipose give them.

    Args:
        where: the file, and the camera in it, for messages.
        values: values by key (`has_camera_matrix`).
        name: name of the file. With `fisheye` in it, four coefficients are those of cv2.fisheye.

    Raises:
        PrepareError: A number is missing or wrong, two keys of one meaning differ, or the model is
            neither a pinhole nor OpenCV's fisheye.
    """
    matrix = _found(where, values, "matrix")
    if len(matrix) == 4:
        fx, fy, cx, cy = matrix
        matrix = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1])
    distortion = _found(where, values, "distortion")
    read = {*VALUE_NAMES["distortion"], *DISTORTION_MODELS}
    others = {key: value for key, value in values.items() if plain_key(key) not in read}
    refuse_distortion(where, name, [*others])
    apart = [
        key
        for key, value in others.items()
        if _APART.fullmatch(plain_key(key)) and value is not None and _count(value)
    ]
    if apart and not len(distortion):
        raise PrepareError(
            f"{where}: distortion must be one list of OpenCV's coefficients (dist: [k1, k2, p1, "
            f"p2]), got {', '.join(map(str, apart))}. Write it so, with zeros for what is missing."
        )
    fisheye = is_fisheye(where, values) or ("fisheye" in name.lower() and len(distortion) == 4)
    said = _found(where, values, "size")
    size = said if len(said) else sides_in(values)
    camera = opencv_camera(
        where,
        name,
        matrix.reshape(3, 3),
        distortion,
        np.eye(3, 4),
        (float(size[0]), float(size[1])) if all(size) else (0, 0),
        fisheye=fisheye,
    )
    return camera.lens


def _found(
    where: str, values: Mapping[str, Any], what: str, told: bool = True
) -> Float[np.ndarray, " n"]:
    """The numbers under the keys of one meaning, of which those with other counts are another
    thing; none if there are no keys. Not `told`: none, too, if the numbers are wrong."""
    keys = [key for key in values if plain_key(key) in VALUE_NAMES[what]]
    found: dict[str, np.ndarray] = {}
    complaint = ""
    for key in keys:
        value = values[key]
        # ROS, and OpenCV in JSON: rows, cols and data.
        value = value.get("data") if isinstance(value, Mapping) else value
        try:
            numbers = finite_numbers(value, _COUNTS[what])
            found[str(key)] = numbers
        except ValueError as error:
            absent = value is None or value is False or _count(value) == 0
            absent = absent or (isinstance(value, str) and value in ("", "null"))
            complaint = complaint or ("" if absent else f"{where}: {key} {error}")
    if told and not found and complaint:
        raise PrepareError(f"{complaint}. Correct or remove it.")
    for key, numbers in found.items():
        first = next(iter(found))
        if told and not np.array_equal(numbers, found[first]):
            raise PrepareError(
                f"{where}: {first} and {key} must not differ, because both are the {what}. Keep "
                "one of them."
            )
    return next(iter(found.values()), np.zeros(0))


def _count(value: Any) -> int:
    """How many numbers a value has; lists of unlike lengths count as several."""
    try:
        return int(np.size(value))
    except ValueError:
        return len(value)
