"""NumPy's .npz files with one array of each value, of all cameras: K [N, 3, 3], R, T, dist."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.prepare.calibrations.known_camera import Calibration
from gaussray.prepare.calibrations.opencv_json import opencv_cameras
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError


# Names of the array of the cameras' names.
_NAMES = ("names", "cameras", "cameranames", "camnames", "cams", "ids", "cameraids", "serials")
_REMEDY = (
    "Save them with it, in the order of the arrays: numpy.savez(FILE, names=['cam1', 'cam2'], "
    "K=K, R=R, T=T, dist=dist)."
)


def camera_stack(values: Mapping[str, np.ndarray]) -> str | None:
    """The key of an array of several cameras' matrices [N, 3, 3]; None if there is none.

    Args:
        values: arrays by key.
    """
    keys = [key for key in values if plain_key(key) in VALUE_NAMES["matrix"]]
    return next((key for key in keys if values[key].shape[1:] == (3, 3)), None)


def stacked_cameras(path: Path, values: Mapping[str, np.ndarray]) -> Calibration:
    """The cameras of a file whose arrays have one entry of several numbers for each; other arrays
    count for all.

    Args:
        path: the file, for messages.
        values: its arrays by key (`camera_stack`).

    Raises:
        PrepareError: There is no array of as many names, or numbers make no camera.
    """
    key = camera_stack(values)
    assert key is not None
    count = len(values[key])
    names = next((values[key] for key in values if plain_key(key) in _NAMES), np.zeros(0))
    if names.shape != (count,) or names.dtype.kind not in "iuU":
        raise PrepareError(
            f"{path}: must hold the names of its {count} cameras as names, got "
            f"{', '.join(values)[:200]}. {_REMEDY}"
        )
    if not count or values[key].dtype.kind not in "fiu" or not np.isfinite(values[key]).all():
        raise PrepareError(
            f"{path}: {key} must be finite numbers, 3 x 3 for each camera, got "
            f"{str(values[key].tolist())[:80]}. Calibrate it again."
        )
    arrays = {
        key: value for key, value in values.items() if value.ndim and plain_key(key) not in _NAMES
    }
    parts: list[dict[str, Any]] = [
        {
            key: one[k] if len(one) == count and one[0].size > 1 else one
            for key, one in arrays.items()
        }
        for k in range(count)
    ]
    listed = [{"name": str(name), **one} for name, one in zip(names, parts, strict=True)]
    cameras = opencv_cameras(path, listed)
    assert cameras is not None
    return cameras
