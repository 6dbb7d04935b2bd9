"""The pose of one camera among the values of a file: R and t, or one matrix of both."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.opencv_numbers import numbers_under
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.pose_math import inverse_pose
from gaussray.runtime.progress import say


_ROTATION = (*VALUE_NAMES["rotation"], "rotationvalues", "rvec", "rotationvector")
_TRANSLATION = (*VALUE_NAMES["translation"], "translationvalues")
# Names of one matrix [R | t], with or without a last row 0 0 0 1. OpenPose calls it CameraMatrix.
_WORLD_TO_CAMERA = (
    *("rt", "extrinsic", "extrinsics", "extrinsicmatrix", "extrinsicsmatrix", "w2c"),
    *("worldtocamera", "worldtocam", "world2camera", "world2cam", "cameramatrix"),
)
_CAMERA_TO_WORLD = ("c2w", "cameratoworld", "camtoworld", "camera2world", "cam2world")
POSE_NAMES = (*_ROTATION, *_TRANSLATION, *_WORLD_TO_CAMERA, *_CAMERA_TO_WORLD)
# Keys of a text that says which way poses are, and words in it of other axes than OpenCV's.
_WAYS = (
    *("convention", "poseconvention", "extrinsicconvention", "extrinsicsconvention", "posetype"),
    *("extrinsictype", "extrinsicstype", "direction", "coordinatesystem", "coordinateconvention"),
)
_OTHER_AXES = ("opengl", "blender", "nerf", "unity", "unreal")
# What is said of a camera without a pose, after its name, and how to mend it.
NO_POSE = "has no R (3 or 9 numbers) and t (3 numbers), nor RT (12 or 16)"
POSE_REMEDY = (
    "All take world to camera (c2w the reverse); R is a matrix or a rotation vector, RT the matrix "
    "of R and t, row by row."
)


class FoundPose(NamedTuple):
    """A pose as a file says it: the keys that have it, its 12 or 16 numbers row by row, and whether
    they take camera to world."""

    keys: str
    numbers: Float[np.ndarray, " n"]
    inverse: bool


def found_pose(values: Mapping[str, Any]) -> FoundPose | None:
    """The pose among a camera's values: R and t, else a matrix from world to camera, else one from
    camera to world. A text beside them (`convention: camera_to_world`) may say the way of the
    first two. None if there are no keys of these with finite numbers of the right count.

    Args:
        values: the camera's values by key.
    """
    turn, shift = (
        numbers_under(values, _ROTATION, (3, 9)),
        numbers_under(values, _TRANSLATION, (3,)),
    )
    if turn is not None and shift is not None:
        rotation = turn[1] if len(turn[1]) == 9 else _from_vector(turn[1])
        matrix = np.column_stack([rotation.reshape(3, 3), shift[1]])
        return FoundPose(f"{turn[0]} and {shift[0]}", matrix.ravel(), _is_said_inverse(values))
    for names, inverse in ((_WORLD_TO_CAMERA, False), (_CAMERA_TO_WORLD, True)):
        found = numbers_under(values, names, (12, 16))
        if found is not None:
            return FoundPose(*found, inverse or _is_said_inverse(values))
    return None


def pose_direction_labels(values: Mapping[str, Any]) -> dict[str, Any]:
    """The texts among values that may say which way poses are, and their axes.

    Args:
        values: values by key.
    """
    return {k: v for k, v in values.items() if plain_key(k) in _WAYS and isinstance(v, str)}


def _is_said_inverse(values: Mapping[str, Any]) -> bool:
    """Whether a text says that poses are from camera to world."""
    texts = [plain_key(text) for text in pose_direction_labels(values).values()]
    return any(name in text for text in texts for name in _CAMERA_TO_WORLD)


def refuse_other_axes(where: object, values: Mapping[str, Any]) -> None:
    """Refuse a camera whose texts say other axes than OpenCV's.

    Args:
        where: the file, and the camera in it, for messages.
        values: the camera's values by key.

    Raises:
        PrepareError: They do.
    """
    for key, text in pose_direction_labels(values).items():
        if any(word in plain_key(text) for word in _OTHER_AXES):
            raise PrepareError(
                f"{where}: poses must have OpenCV's axes (x right, y down, z forward), got {key}: "
                f"{text[:80]}. Turn them, or write a transforms.json, which has OpenGL's."
            )


def world_to_camera(where: object, name: object, pose: FoundPose) -> Float[np.ndarray, "3 4"]:
    """The matrix of a pose from world to camera. That of a rotation is one if the file's is.

    Args:
        where: the file, for messages.
        name: name of the camera.
        pose: the pose as the file says it.

    Raises:
        PrepareError: A fourth row is not 0 0 0 1.
    """
    matrix = pose.numbers.reshape(-1, 4)
    if len(matrix) == 4 and np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
        transposed = np.abs(matrix[:, 3] - (0, 0, 0, 1)).max() <= 1e-6
        raise PrepareError(
            f"{where}: {pose.keys} of camera {name} must end with the row 0 0 0 1, got "
            f"{matrix[3].tolist()}. {'Is it transposed? ' if transposed else ''}Write it row by "
            "row, with t as its last column."
        )
    if not pose.inverse:
        return matrix[:3]
    with np.errstate(all="ignore"):  # numbers that are too large are told of by `opencv_camera`
        return inverse_pose(matrix[:3])


def say_poses(where: object, poses: Iterable[FoundPose]) -> None:
    """Print which way the poses of a file are taken.

    Args:
        where: the file or folder.
        poses: poses of its cameras.
    """
    for keys, inverse in dict.fromkeys((pose.keys, pose.inverse) for pose in poses):
        verb = "are" if " and " in keys else "is"
        way = "from world to camera."
        if inverse:
            way = "from camera to world, and inverted (axes: x right, y down, z forward)."
        say(f"{where}: {keys} {verb} taken as OpenCV's, {way}")


def _from_vector(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The matrix of a rotation vector; not finite if its length is not."""
    with np.errstate(all="ignore"):
        return Rotation.from_rotvec(vector).as_matrix()
