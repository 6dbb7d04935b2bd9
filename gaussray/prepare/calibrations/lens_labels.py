"""What the labels among a camera's values say of its lens: OpenCV's model, or its fisheye."""

from collections.abc import Collection, Mapping
from functools import partial
from typing import Any

import numpy as np

from gaussray.prepare.calibrations.value_names import plain_key
from gaussray.prepare.errors import PrepareError


# Names of models (ROS, Kalibr, EuRoC, COLMAP), as plain keys: OpenCV's, and its fisheye.
_RADTAN = ("radtan", "radialtangential", "plumbbob", "rationalpolynomial", "brownconrady")
_PLAIN = ("", "none", *_RADTAN, "opencv", "fullopencv")
_FISHEYE = ("equidistant", "equi", "fisheye", "opencvfisheye", "kannalabrandt", "kannalabrandt4")
_PINHOLE = ("pinhole", "simplepinhole", "perspective", "rectilinear")
_CAMERAS = ("", *_PINHOLE, *_PLAIN, *_FISHEYE)
# Plain keys of the names of models, and those that say a fisheye otherwise: Pose2Sim, OpenCV's
# sample.
DISTORTION_MODELS = ("distortionmodel", "distortionmodels")
_CAMERA_MODELS = ("cameramodel", "cameramodels")
_FISHEYES = ("fisheye", "fisheyemodel")
MODEL_LABELS = (*DISTORTION_MODELS, *_CAMERA_MODELS, *_FISHEYES)
# What a text under the last of these says.
_WORDS = {**dict.fromkeys(("true", "yes"), True), **dict.fromkeys(("false", "no"), False)}


def labels_in(values: Mapping[str, Any], names: Collection[str] = MODEL_LABELS) -> dict[str, Any]:
    """The values that may say the model of a lens.

    Args:
        values: values by key.
        names: plain keys of these labels.
    """
    return {key: value for key, value in values.items() if plain_key(key) in names}


# The labels of each meaning among values: the model of distortion, that of the camera, a fisheye.
LABEL_MEANINGS = tuple(
    partial(labels_in, names=names) for names in (DISTORTION_MODELS, _CAMERA_MODELS, _FISHEYES)
)


def is_fisheye(where: object, values: Mapping[str, Any]) -> bool:
    """Whether labels among the values of a camera say that its lens is OpenCV's fisheye.

    Args:
        where: the file, and the camera in it, for messages.
        values: values by key.

    Raises:
        PrepareError: They say neither a pinhole nor OpenCV's fisheye, or contradict each other.
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
    says = [_says(where, key, value) for key, value in labels_in(values, _FISHEYES).items()]
    by_model = distortion in _FISHEYE or camera in _FISHEYE
    if (by_model and False in says and True not in says) or (
        True in says and distortion in _RADTAN
    ):
        raise PrepareError(
            f"{where}: must not say fisheye: {str(True in says).lower()} with the model "
            f"{distortion or camera}. Correct or remove one of them."
        )
    return by_model or True in says


def _says(where: object, key: object, value: Any) -> bool | None:
    """What a value says: one number, whether it is not 0; a text, yes or no. Others nothing."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    if isinstance(value, str) and value.strip():
        said = _WORDS.get(value.strip().lower())
        if said is None:
            raise PrepareError(
                f"{where}: {key} must be true or false, got {value[:80]}. Correct it."
            )
        return said
    if isinstance(value, list | tuple) and len(value) == 1:
        return _says(where, key, value[0])
    return bool(value) if isinstance(value, bool | int | float | np.generic) else None
