"""The lens of one camera from the values that programs around OpenCV write, without a pose."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaussray.prepare.calibrations.distortions import distortion_in
from gaussray.prepare.calibrations.known_camera import opencv_camera, refuse_distortion
from gaussray.prepare.calibrations.lens_labels import DISTORTION_MODELS, is_fisheye
from gaussray.prepare.calibrations.opencv_numbers import agreed_numbers, numbers_under
from gaussray.prepare.calibrations.picture_sizes import size_in
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.lens_models import LensKeyValues


# A matrix has nine numbers; Kalibr and EuRoC write its focal lengths and principal point alone.
_MATRIX = (9, 4)


def has_camera_matrix(values: Any) -> bool:
    """Whether the values of a file, or of a part of it, are of one camera with a matrix."""
    return (
        isinstance(values, Mapping)
        and numbers_under(values, VALUE_NAMES["matrix"], _MATRIX) is not None
    )


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
    matrix = agreed_numbers(where, values, "matrix", _MATRIX)
    if len(matrix) == 4:
        fx, fy, cx, cy = matrix
        matrix = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1])
    distortion = distortion_in(where, values)
    read = {*VALUE_NAMES["distortion"], *DISTORTION_MODELS}
    refuse_distortion(where, name, [key for key in values if plain_key(key) not in read])
    fisheye = is_fisheye(where, values) or ("fisheye" in name.lower() and len(distortion) == 4)
    camera = opencv_camera(
        where,
        name,
        matrix.reshape(3, 3),
        distortion,
        np.eye(3, 4),
        size_in(where, values),
        fisheye=fisheye,
    )
    return camera.lens
