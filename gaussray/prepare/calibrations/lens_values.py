"""A camera from the values that programs around OpenCV write, with a pose or without."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gaussray.prepare.calibrations.distortions import distortion_in
from gaussray.prepare.calibrations.known_camera import KnownCamera, opencv_camera, refuse_distortion
from gaussray.prepare.calibrations.lens_labels import DISTORTION_MODELS, is_fisheye
from gaussray.prepare.calibrations.opencv_numbers import agreed_numbers
from gaussray.prepare.calibrations.picture_sizes import size_in
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key


def camera_of_values(
    path: Path,
    name: str,
    values: Mapping[str, Any],
    pose: Float[np.ndarray, "3 4"] | None = None,
) -> KnownCamera:
    """A camera: its matrix, distortion, size and model, under the names that OpenCV's users, ROS,
    Kalibr, EuRoC, Pose2Sim and Anipose give them.

    Args:
        path: the file, for messages.
        name: name of the camera. The file's own, for the lens of a file of one camera: with
            `fisheye` in it, four coefficients are those of cv2.fisheye.
        values: values by key (`plain_camera`) with a matrix.
        pose: world to camera; None for a lens alone, at the origin.

    Raises:
        PrepareError: A number is missing or wrong, two keys of one meaning differ, or the model is
            neither a pinhole nor OpenCV's fisheye.
    """
    of_file = pose is None and name == path.name
    where = str(path) if of_file else f"{path}, camera {name}"
    matrix = agreed_numbers(where, values, "matrix", (9,)).reshape(3, 3)
    distortion = distortion_in(where, values)
    read = {*VALUE_NAMES["distortion"], *DISTORTION_MODELS}
    refuse_distortion(path, name, [key for key in values if plain_key(key) not in read])
    called = of_file and "fisheye" in name.lower() and len(distortion) == 4
    return opencv_camera(
        path,
        name,
        matrix,
        distortion if len(distortion) else np.zeros(4),
        np.eye(3, 4) if pose is None else pose,
        size_in(where, values),
        fisheye=is_fisheye(where, values) or called,
    )
