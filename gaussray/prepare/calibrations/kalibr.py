"""Camera chains of Kalibr (camchain.yaml)."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.prepare.calibrations.known_camera import (
    ALL_KINDS,
    KnownCamera,
    check_name,
    opencv_camera,
)
from gaussray.prepare.calibrations.yaml_file import yaml_content
from gaussray.prepare.errors import PrepareError


_DISTORTIONS = {"radtan": False, "none": False, "equidistant": True, "equi": True}
# Keys at the top of a file of intrinsics.
_LENS_ALONE = re.compile(
    "k|(camera|intrinsic)s?_?matrix|dist(ortion)?_?coef(f|ficient)?s?", re.IGNORECASE
)
_REMEDY = "Give the camchain.yaml that Kalibr has written, unchanged."


def read_kalibr(path: Path) -> list[KnownCamera]:
    """The cameras of a chain cam0, cam1, ...; the first camera's axes are the world's.

    `T_cn_cnm1` takes the camera before to this one; without it only the first camera has a pose.

    Raises:
        PrepareError: The file is no chain of Kalibr, or a camera's model is not supported.
    """
    content = yaml_content(path)
    keys = [str(key) for key in content] if isinstance(content, dict) else []
    _refuse_intrinsics(path, keys)
    names = [k for k in content if str(k).startswith("cam")] if keys else []
    if not names:
        raise PrepareError(
            f"{path}: must list cameras cam0, cam1, ... as Kalibr does, got none. {_REMEDY}"
        )
    cameras, pose = [], np.eye(4)
    for k, name in enumerate(sorted(names, key=lambda n: (len(str(n)), str(n)))):
        block = content[name]
        if not isinstance(block, dict):
            raise PrepareError(
                f"{path}: {name} must be a block of keys, got {str(block)[:80]}. {_REMEDY}"
            )
        if k:
            pose = _numbers(path, name, block, "T_cn_cnm1", 16).reshape(4, 4) @ pose
        cameras.append(_camera(path, check_name(path, name), block, pose[:3]))
    return cameras


def is_chain(content: Any) -> bool:
    """Whether the content of a YAML file is a chain of Kalibr."""
    values = content.values() if isinstance(content, dict) else ()
    blocks = [one for one in values if isinstance(one, dict)]
    return any(
        "T_cn_cnm1" in one or ("camera_model" in one and "distortion_coeffs" in one)
        for one in blocks
    )


def _refuse_intrinsics(path: Path, keys: list[str]) -> None:
    """Refuse the lens of one camera, as programs with OpenCV and ROS write it, without a pose."""
    lens = next((key for key in keys if _LENS_ALONE.fullmatch(key)), None)
    if lens is not None:
        raise PrepareError(
            f"{path}: holds the lens of one camera ({lens}), and poses.calibration needs the "
            f"lenses and poses of all cameras. Give a file that has them, or leave it out and give "
            f"poses.lens={path} to estimate poses with this lens. {ALL_KINDS}"
        )


def _numbers(path: Path, name: str, block: dict[str, Any], key: str, count: int) -> np.ndarray:
    try:
        return np.array(block[key], np.float64).reshape(count)
    except (KeyError, ValueError, TypeError):
        raise PrepareError(
            f"{path}: {name}.{key} must be {count} numbers, got {str(block.get(key))[:80]}. "
            f"{_REMEDY}"
        ) from None


def _camera(path: Path, name: str, block: dict[str, Any], pose: np.ndarray) -> KnownCamera:
    model, distortion = block.get("camera_model"), block.get("distortion_model", "none")
    if model != "pinhole" or distortion not in _DISTORTIONS:
        raise PrepareError(
            f"{path}: {name} must be a pinhole with radtan or equidistant distortion, got {model} "
            f"with {distortion}. Calibrate with --models pinhole-radtan or pinhole-equi."
        )
    focal = _numbers(path, name, block, "intrinsics", 4)
    matrix = np.array([[focal[0], 0, focal[2]], [0, focal[1], focal[3]], [0, 0, 1]])
    coefficients = np.zeros(4)
    if distortion != "none":
        coefficients = _numbers(path, name, block, "distortion_coeffs", 4)
    size = _numbers(path, name, block, "resolution", 2)
    fisheye = _DISTORTIONS[distortion]
    return opencv_camera(
        path, name, matrix, coefficients, pose, (float(size[0]), float(size[1])), fisheye=fisheye
    )
