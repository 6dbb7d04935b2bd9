"""Poses as matrices: their inverse, and where the camera is."""

import numpy as np
from scipy.spatial.transform import Rotation

from gaussray.prepare.pose_math import camera_centre, inverse_pose


TURNS = Rotation.from_rotvec([[0, 0, 0], [0.3, -1.0, 2.0]]).as_matrix()
POSES = np.concatenate([TURNS, [[[1], [2], [3]], [[-4], [5], [0.5]]]], axis=-1)


def test_a_pose_after_its_inverse_moves_nothing():
    inverse = inverse_pose(POSES)
    # R (R' x + t') + t = x.
    np.testing.assert_allclose(TURNS @ inverse[..., :3], np.tile(np.eye(3), (2, 1, 1)), atol=1e-15)
    shift = TURNS @ inverse[..., 3:] + POSES[..., 3:]
    np.testing.assert_allclose(shift, np.zeros((2, 3, 1)), atol=1e-14)
    np.testing.assert_allclose(inverse_pose(inverse), POSES, atol=1e-14)
    np.testing.assert_array_equal(inverse_pose(POSES[1]), inverse[1])


def test_a_camera_is_where_its_own_coordinates_are_zero():
    centre = camera_centre(POSES)
    own = np.einsum("nij,nj->ni", TURNS, centre) + POSES[..., 3]
    np.testing.assert_allclose(own, np.zeros((2, 3)), atol=1e-14)
    np.testing.assert_array_equal(centre[0], [-1, -2, -3])
