"""Calibrated cameras of one pose: of videos a mistake, of photographs two from one place."""

import itertools
from collections.abc import Mapping

import numpy as np

from gaussray.prepare.calibrations.known_camera import KnownCamera
from gaussray.prepare.pose_math import camera_centre


# Poses are the same if no number of the rotations differs by more, nor the places by more of their
# largest distance from the origin: only copies are so close.
_SAME = 1e-9


def pairs_of_one_pose(cameras: Mapping[str, KnownCamera]) -> list[tuple[str, str]]:
    """The names of each two cameras that have the same rotation and the same place.

    Args:
        cameras: calibrated cameras by name.
    """
    position = {name: camera_centre(camera.pose) for name, camera in cameras.items()}
    far = max((float(np.linalg.norm(centre)) for centre in position.values()), default=0.0)

    def same(one: str, two: str) -> bool:
        turn = np.abs(cameras[one].pose[:, :3] - cameras[two].pose[:, :3]).max()
        return bool(turn <= _SAME and np.abs(position[one] - position[two]).max() <= _SAME * far)

    return [pair for pair in itertools.combinations(cameras, 2) if same(*pair)]
