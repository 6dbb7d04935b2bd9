"""The cameras of scripts around OpenCV: K, R and t of each under their usual names."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from gaussray.prepare.calibrations.camera_values import has_matrix, tell_readings
from gaussray.prepare.calibrations.known_camera import Calibration, KnownCamera, check_name
from gaussray.prepare.calibrations.lens_values import camera_of_values
from gaussray.prepare.calibrations.named_cameras import named_cameras, whole_camera
from gaussray.prepare.calibrations.opencv_pose import (
    NO_POSE,
    POSE_REMEDY,
    found_pose,
    refuse_other_axes,
    world_to_camera,
)
from gaussray.prepare.errors import PrepareError


def is_opencv_camera(content: Any) -> bool:
    """Whether values (`plain_camera`) have a camera's K and pose."""
    return has_matrix(content) and found_pose(content) is not None


def opencv_cameras(path: Path, content: Any) -> Calibration | None:
    """The cameras of a file, by the keys of an object or the names in a list; None if it has none.

    Each has a 3 x 3 matrix K (or fx fy cx cy) and a pose, which is a rotation R (a matrix or a
    Rodrigues vector) and a translation t, or a matrix of both (OpenCV, world to camera), and may
    have distortion and size (columns and rows); also in blocks `intrinsics` and `extrinsics`. A
    projection K [R | t] may stand for both. One with K alone is left out.

    Args:
        path: the file, for messages.
        content: what it holds, at the top or under `cameras` (`named_cameras`).

    Raises:
        PrepareError: Numbers make no camera, no camera has a pose, two have one name or one of a
            list has none, or the file has one camera alone.
    """
    if (camera := whole_camera(path, content)) is not None:
        _refuse_single(path, camera)
        if (camera := whole_camera(path, content.get("cameras"))) is not None:
            _refuse_single(path, camera)
    listed = named_cameras(path, content)
    found = {name: one for name, one in listed.items() if is_opencv_camera(one)}
    left_out = {name: NO_POSE for name in listed if name not in found}
    if left_out and not found:
        name = next(iter(left_out))
        raise PrepareError(
            f"{path}: must have a camera with a pose, got none: camera {name} {NO_POSE}"
            f"{_keys_of(listed[name])}. {POSE_REMEDY}"
        )
    cameras = [read_opencv_camera(path, name, one) for name, one in found.items()]
    tell_readings(path, list(found.values()))
    return Calibration(cameras, left_out) if cameras else None


def refuse_single_camera(path: Path) -> NoReturn:
    """Refuse a file of one camera where one of all cameras is needed.

    Raises:
        PrepareError: Always, with the folder to give.
    """
    raise PrepareError(
        f"poses.calibration={path}: must hold all cameras, got one. If each has a file of its own, "
        f"called as its video, give their folder: poses.calibration={path.parent}. If each lies in "
        "a folder that is called so, give the folder above."
    )


def read_opencv_camera(path: Path, name: object, values: Mapping[str, Any]) -> KnownCamera:
    """The camera of a part of a file.

    Args:
        path: the file, for messages.
        name: name of the camera.
        values: its values (`plain_camera`), of which some are its pose.

    Raises:
        PrepareError: The numbers make no camera.
    """
    pose = found_pose(values)
    assert pose is not None
    refuse_other_axes(f"{path}, camera {name}", values)
    matrix = world_to_camera(path, name, pose)
    return camera_of_values(path, check_name(path, name), values, matrix)


def _refuse_single(path: Path, camera: Mapping[str, Any]) -> None:
    """Refuse a file whose top, or whose `cameras`, is one camera."""
    if is_opencv_camera(camera):
        refuse_single_camera(path)
    if has_matrix(camera):
        raise PrepareError(f"{path}: the camera {NO_POSE}{_keys_of(camera)}. {POSE_REMEDY}")


def _keys_of(camera: Mapping[str, Any]) -> str:
    return f", got {', '.join(map(str, camera))[:200]}"
