"""The cameras of scripts around OpenCV: K, R and t of each under their usual names."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from gaussray.prepare.calibrations.distortions import (
    common_distortions,
    distortion_in,
    distortions_in,
)
from gaussray.prepare.calibrations.known_camera import (
    Calibration,
    KnownCamera,
    check_name,
    opencv_camera,
    refuse_distortion,
)
from gaussray.prepare.calibrations.lens_labels import (
    DISTORTION_MODELS,
    LABEL_MEANINGS,
    is_fisheye,
    labels_in,
)
from gaussray.prepare.calibrations.opencv_numbers import numbers_under
from gaussray.prepare.calibrations.opencv_pose import (
    NO_POSE,
    POSE_REMEDY,
    found_pose,
    say_poses,
    world_to_camera,
)
from gaussray.prepare.calibrations.picture_sizes import SMALLEST, sides_in, size_in, sizes_in
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError


# Keys of a list's cameras that hold their names.
CAMERA_NAME_KEYS = ("name", "camera", "cam", "id", "camera_id", "serial")

# Keys that beside cameras are of a chessboard if their numbers are small.
_PLAIN_SIDES = ("width", "height", "w", "h")


def is_opencv_camera(content: Any) -> bool:
    """Whether the values of a file, or of a part of it, have a camera's K and pose."""
    return _has_matrix(content) and found_pose(content) is not None


def opencv_cameras(path: Path, content: Any) -> Calibration | None:
    """The cameras of a file, by the keys of an object or the names in a list; None if it has none.

    Each has a 3 x 3 matrix K and a pose, which is a rotation R (a matrix or a Rodrigues vector) and
    a translation t, or a matrix of both (OpenCV, world to camera), and may have distortion and
    size (columns and rows). One with K alone is left out.

    Args:
        path: the file, for messages.
        content: what it holds, at the top or under `cameras`.

    Raises:
        PrepareError: Numbers make no camera, no camera has a pose, two have one name or one of a
            list has none, or the file has one camera alone.
    """
    if is_opencv_camera(content):
        refuse_single_camera(path)
    common = common_values(content)
    if isinstance(content, dict) and isinstance(content.get("cameras"), dict | list):
        content = content["cameras"]
    if _has_matrix(content):
        raise PrepareError(f"{path}: the camera {NO_POSE}{_keys_of(content)}. {POSE_REMEDY}")
    listed = _listed(path, content) or _by_camera(content)
    listed = {key: with_common(one, common) for key, one in listed.items()}
    found = {name: one for name, one in listed.items() if is_opencv_camera(one)}
    left_out = {name: NO_POSE for name in listed if name not in found}
    if left_out and not found:
        name = next(iter(left_out))
        raise PrepareError(
            f"{path}: must have a camera with a pose, got none: camera {name} {NO_POSE}"
            f"{_keys_of(listed[name])}. {POSE_REMEDY}"
        )
    cameras = [read_opencv_camera(path, name, one) for name, one in found.items()]
    say_poses(path, filter(None, map(found_pose, found.values())))
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


def _listed(path: Path, content: Any) -> dict[str, dict[str, Any]]:
    """The parts of a file that have a camera's matrix, by the camera's name."""
    if isinstance(content, dict):
        return {str(name): one for name, one in content.items() if _has_matrix(one)}
    result: dict[str, dict[str, Any]] = {}
    for number, one in enumerate(content if isinstance(content, list) else [], 1):
        if not _has_matrix(one):
            continue
        name = said_name(one)
        if name is None:
            raise PrepareError(
                f"{path}: camera {number} of the list must have a name "
                f"({', '.join(CAMERA_NAME_KEYS)}), got none. Give each the name of its video."
            )
        if name in result:
            raise PrepareError(
                f"{path}: each camera must have a name of its own, got {name} twice. Change one."
            )
        result[name] = one
    return result


def common_values(content: Any) -> dict[str, Any]:
    """What a file says beside its cameras of all: the lens's model and distortion, and the size of
    pictures if it is two whole numbers. A plain `size`, or `width` and `height`, of small numbers
    is a chessboard's, and not of these."""
    if not isinstance(content, Mapping):
        return {}
    labels = labels_in(content)
    labels = {key: value for key, value in labels.items() if not isinstance(value, Mapping)}
    result = {**labels, **common_distortions(content)}
    sizes = sizes_in(content)
    named = {key for key in sizes if plain_key(key) not in ("size", *_PLAIN_SIDES)}
    plain = {key for key in sizes if plain_key(key) == "size"}
    for keys, least in ((named, 1), (plain, SMALLEST), (sizes.keys() - named - plain, SMALLEST)):
        some = {key: value for key, value in sizes.items() if key in keys}
        found = numbers_under(some, VALUE_NAMES["size"], (2,))
        size = [float(side) for side in (sides_in(some) if found is None else found[1])]
        if min(size) >= least and all(side.is_integer() for side in size):
            return {**result, "size": size}
    return result


def with_common(camera: Mapping[str, Any], common: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a camera, and those of all cameras for each meaning (size, distortion, its
    model, the camera's, fisheye) of which it says nothing.

    Args:
        camera: the camera's values by key.
        common: values of all (`common_values`).
    """
    result = dict(camera)
    for names in (sizes_in, distortions_in, *LABEL_MEANINGS):
        own, others = names(camera), names(common)
        if others and not any(map(_is_said, own.values())):
            result = {key: value for key, value in result.items() if key not in own} | others
    return result


def _is_said(value: Any) -> bool:
    return value is not None and not (isinstance(value, str) and not value.strip())


def _by_camera(content: Any) -> dict[str, dict[str, Any]]:
    """The cameras of an object that has an object for each value, with the value of each camera by
    the camera's name: `intrinsics: {a: K}, extrinsics: {a: RT}`."""
    blocks = content if isinstance(content, dict) else {}
    blocks = {key: block for key, block in blocks.items() if isinstance(block, dict)}
    if not any(plain_key(key) in VALUE_NAMES["matrix"] for key in blocks):
        return {}
    result: dict[str, dict[str, Any]] = {}
    for key, block in blocks.items():
        for name, value in block.items():
            values = value if isinstance(value, dict) else {key: value}
            result.setdefault(str(name), {}).update(values)
    return {name: one for name, one in result.items() if _has_matrix(one)}


def read_opencv_camera(path: Path, name: object, content: Mapping[str, Any]) -> KnownCamera:
    """The camera of a part of a file.

    Args:
        path: the file, for messages.
        name: name of the camera.
        content: its keys (`is_opencv_camera`).

    Raises:
        PrepareError: The numbers make no camera.
    """
    matrix, pose = numbers_under(content, VALUE_NAMES["matrix"], (9,)), found_pose(content)
    assert matrix is not None and pose is not None
    where = f"{path}, camera {name}"
    distortion = distortion_in(where, content)
    read = {*VALUE_NAMES["distortion"], *DISTORTION_MODELS}
    unread = [key for key in content if plain_key(key) not in read]
    refuse_distortion(path, name, unread)
    return opencv_camera(
        path,
        check_name(path, name),
        matrix[1].reshape(3, 3),
        distortion if len(distortion) else np.zeros(4),
        world_to_camera(path, name, pose),
        size_in(where, content),
        fisheye=is_fisheye(where, content),
    )


def _has_matrix(content: Any) -> bool:
    return (
        isinstance(content, Mapping)
        and numbers_under(content, VALUE_NAMES["matrix"], (9,)) is not None
    )


def _keys_of(camera: Mapping[str, Any]) -> str:
    return f", got {', '.join(map(str, camera))[:200]}"


def said_name(camera: Mapping[str, Any]) -> str | None:
    """The name of a camera of a list; None if it has none. A truth value is none."""
    found = (camera[key] for key in CAMERA_NAME_KEYS if type(camera.get(key)) in (str, int))
    return next(map(str, found), None)
