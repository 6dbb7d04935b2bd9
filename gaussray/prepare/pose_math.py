"""Poses [R | t] as matrices: their inverse, and where the camera is."""

import numpy as np
from jaxtyping import Float


def inverse_pose(pose: Float[np.ndarray, "*n 3 4"]) -> Float[np.ndarray, "*n 3 4"]:
    """The inverse of rotations and translations: camera to world of world to camera."""
    turn = np.swapaxes(pose[..., :3], -1, -2)
    return np.concatenate([turn, camera_centre(pose)[..., None]], axis=-1)


def camera_centre(pose: Float[np.ndarray, "*n 3 4"]) -> Float[np.ndarray, "*n 3"]:
    """Where the cameras of poses from world to camera are, in world space: -R^T t."""
    turn, shift = np.swapaxes(pose[..., :3], -1, -2), pose[..., 3:]
    return (-turn @ shift)[..., 0]
