"""Camera-to-world matrices from the rotations that files of other tools give."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from gaussray.geometry import BLENDER_AXES


def opengl_pose(
    turn: Float[np.ndarray, "3 3"], place: Sequence[float] | Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """A `transform_matrix`: camera to world, OpenGL's camera axes.

    Args:
        turn: rotation, camera to world, of a camera with OpenCV's axes.
        place: where the camera is.
    """
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(BLENDER_AXES)
    matrix[:3, 3] = place
    return matrix


def quaternion_turn(quat: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation of a quaternion (w, x, y, z), of any length above 0."""
    # Imported here, as below: that takes a third of a second, which most captures do not need.
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quat[[1, 2, 3, 0]]).as_matrix()


def axis_angle_turn(turn: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """The rotation about an axis by the axis's length, in radians."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(turn).as_matrix()
