"""calibration_*.json of CMU's Panoptic Studio, and of what writes the same keys."""

from pathlib import Path
from typing import Any

import numpy as np

from gaussray.capture.formats.json_keys import Keys
from gaussray.prepare.calibrations.known_camera import (
    KnownCamera,
    check_distinct_names,
    check_name,
    opencv_camera,
    refuse_distortion,
)
from gaussray.prepare.errors import PrepareError


# Names of its cameras are numbers, and its files are called by their kind, too: hd_00_05.mp4.
_KINDS = ("vga", "hd", "kinect")


def is_panoptic(content: Any) -> bool:
    """Whether the content of a JSON file is a list of cameras, one of which has K, R and
    `distCoef`, or `resolution` and no distortion of another name."""
    cameras = content.get("cameras") if isinstance(content, dict) else None
    return isinstance(cameras, list) and any(
        isinstance(camera, dict)
        and "K" in camera
        and "R" in camera
        and ("distCoef" in camera or ("resolution" in camera and not _has_distortion(camera)))
        for camera in cameras
    )


def _has_distortion(camera: dict[str, Any]) -> bool:
    return any("dist" in key for key in camera)


def panoptic_cameras(path: Path, content: dict[str, Any]) -> list[KnownCamera]:
    """The cameras of a file: `name`, `type`, `resolution`, `K`, `distCoef`, and `R` and `t` from
    world to camera (OpenCV), in the file's own unit (Panoptic's: centimetres).

    A camera of type vga, hd or kinect is called as its video, `hd_00_05`; others by their name.

    Args:
        path: the file, for messages.
        content: what it holds (`is_panoptic`).

    Raises:
        PrepareError: A camera lacks a number, or has distortion of another name, or two have one
            name.
    """
    cameras = [_camera(path, k, camera) for k, camera in enumerate(content["cameras"])]
    check_distinct_names(path, [camera.name for camera in cameras])
    return cameras


def _camera(path: Path, index: int, camera: object) -> KnownCamera:
    where = f"{path}, cameras[{index}]"
    if not isinstance(camera, dict):
        raise PrepareError(f"{where}: must be a block of keys, got {str(camera)[:80]}.")

    def array(key: str, *counts: int) -> np.ndarray:
        try:
            values = np.array(camera.get(key), np.float64).ravel()
        except (ValueError, TypeError):
            values = np.array([np.nan])
        if not np.isfinite(values).all() or (counts and len(values) not in counts):
            wanted = f"{counts[0]} numbers" if counts else "numbers"
            raise PrepareError(
                f"{where}: {key} must be {wanted}, got {str(camera.get(key))[:80]}. It needs name, "
                "resolution, K, distCoef, R and t."
            )
        return values

    name = check_name(path, Keys(path, camera, prefix=f"cameras[{index}].").text("name"))
    kind = camera.get("type")
    width, height = array("resolution", 2)
    refuse_distortion(path, name, [key for key in camera if key != "distCoef"])
    return opencv_camera(
        path,
        f"{kind}_{name}" if kind in _KINDS and not name.startswith(kind) else name,
        array("K", 9).reshape(3, 3),
        array("distCoef") if camera.get("distCoef") is not None else np.zeros(4),
        np.column_stack([array("R", 9).reshape(3, 3), array("t", 3)]),
        (float(width), float(height)),
    )
