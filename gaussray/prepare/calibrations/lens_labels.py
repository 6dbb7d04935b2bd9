"""What the labels among a camera's values say of its lens: OpenCV's model, or its fisheye."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaussray.prepare.calibrations.value_names import plain_key
from gaussray.prepare.errors import PrepareError


# Names of models (ROS, Kalibr, EuRoC, COLMAP), as plain keys: OpenCV's, and its fisheye.
_PLAIN = (
    *("", "none", "radtan", "radialtangential", "plumbbob", "rationalpolynomial"),
    *("opencv", "fullopencv"),
)
_FISHEYE = ("equidistant", "equi", "fisheye", "opencvfisheye", "kannalabrandt", "kannalabrandt4")
_CAMERAS = ("", "pinhole", *_PLAIN, *_FISHEYE)
# Plain keys of the names of models, and those that say a fisheye otherwise: Pose2Sim, OpenCV's
# sample.
DISTORTION_MODELS = ("distortionmodel", "distortionmodels")
_CAMERA_MODELS = ("cameramodel", "cameramodels")
_FISHEYES = ("fisheye", "fisheyemodel")
MODEL_LABELS = (*DISTORTION_MODELS, *_CAMERA_MODELS, *_FISHEYES)


def labels_in(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values that may say the model of a lens.

    Args:
        values: values by key.
    """
    return {key: value for key, value in values.items() if plain_key(key) in MODEL_LABELS}


def is_fisheye(where: object, values: Mapping[str, Any]) -> bool:
    """Whether labels among the values of a camera say that its lens is OpenCV's fisheye.

    Args:
        where: the file, and the camera in it, for messages.
        values: values by key.

    Raises:
        PrepareError: They say neither a pinhole nor OpenCV's fisheye.
    """
    models = {plain_key(k): plain_key(v) for k, v in values.items() if isinstance(v, str)}
    distortion, camera = (
        next((models[key] for key in keys if models.get(key)), "")
        for keys in (DISTORTION_MODELS, _CAMERA_MODELS)
    )
    if distortion not in (*_PLAIN, *_FISHEYE) or camera not in _CAMERAS:
        raise PrepareError(
            f"{where}: must be a pinhole with OpenCV's distortion (radtan, plumb_bob, "
            f"rational_polynomial) or its fisheye (equidistant), got {camera or 'pinhole'} with "
            f"{distortion or 'none'}. Calibrate it with one of these models, or remove the key if "
            "it names a product."
        )
    says = (value for key, value in values.items() if plain_key(key) in _FISHEYES)
    said = any(_is_true(value) for value in says)
    return said or distortion in _FISHEYE or camera in _FISHEYE


def _is_true(value: Any) -> bool:
    """Whether a value is one number that is not 0, or true."""
    try:
        return not isinstance(value, str) and np.size(value) == 1 and bool(np.all(value))
    except ValueError:  # lists of unlike lengths
        return False
