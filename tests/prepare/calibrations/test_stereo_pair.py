"""Two lenses, R and T under the names that public files have."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.stereo_pair import (
    has_stereo_lenses,
    has_stereo_pose,
    stereo_cameras,
)
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.lens_models import to_colmap


K1 = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
K2 = np.array([[490.0, 0, 330.0], [0, 495.0, 250.0], [0, 0, 1]])
# k1 k2 p1 p2 k3 k4 k5 k6, as OpenCV orders them.
D1 = np.array([[-0.05, 0.02, 0.001, -0.002, 0.01, 0.03, -0.01, 0.004]])
D2 = np.array([[0.04, -0.03, 0.002, 0.003, -0.005]])
R = Rotation.from_rotvec([0.05, -0.3, 0.1]).as_matrix()
T = np.array([[-0.4], [0.02], [0.1]])


def pair(keys="K1 D1 K2 D2 R T"):
    return dict(zip(keys.split(), (K1, D1, K2, D2, R, T), strict=True))


def projected(matrix, distortion, point):
    """OpenCV's projection of a point in camera axes, pixel centres at whole numbers."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.append(distortion.ravel(), np.zeros(3))[:8]
    x, y = point[:2] / point[2]
    s = x * x + y * y
    radial = (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
    u = x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x)
    v = y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y
    return (matrix @ [u, v, 1])[:2]


def test_points_are_projected_as_opencv_does():
    pycolmap = pytest.importorskip("pycolmap")
    first, second = stereo_cameras("a", pair()).cameras
    for point in np.array([[0.3, -0.2, 2.0], [-0.6, 0.5, 1.5], [0.1, 0.4, 3.0]]):
        moved = (R @ point + T.ravel(), K2, D2)
        for camera, (own, matrix, distortion) in ((first, (point, K1, D1)), (second, moved)):
            model, parameters = to_colmap(camera.lens)
            lens = pycolmap.Camera(model=model, width=640, height=480, params=parameters)
            seen = camera.pose @ np.append(point, 1)
            assert seen == pytest.approx(own, abs=1e-12)
            # Ours has pixel centres at 0.5.
            expected = projected(matrix, distortion, own) + 0.5
            assert lens.img_from_cam(seen[None])[0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    "keys",
    [
        "M1 D1 M2 D2 R T",
        "K1 dist1 K2 dist2 R T",
        "mtxL distL mtxR distR R T",
        "mtx_left dist_left mtx_right dist_right r t",
        "mtx_l dist_l mtx_r dist_r Rot Trans",
        "K_l D_l K_r D_r R T",
        "lk ld rk rd R T",
        "camera_matrix_left dist_coeffs_left camera_matrix_right dist_coeffs_right R T",
        "left_camera_matrix left_distortion_coefficients right_camera_matrix "
        "right_distortion_coefficients rotation_matrix translation_vector",
        "cameraMatrix1 distCoeffs1 cameraMatrix2 distCoeffs2 R T",
        "intrinsics1 distortion1 intrinsics2 distortion2 R T",
        "Intrinsic_mtx_1 dist_1 Intrinsic_mtx_2 dist_2 R T",
        "mtx1 dst1 mtx2 dst2 R T",
        "K0 D0 K1 D1 R T",
        "mtxL dist1 mtxR dist2 R T",
    ],
)
def test_names_of_public_files_are_read(keys):
    extra = {"E": np.eye(3), "F": np.eye(3), "R1": np.eye(3), "R2": R, "P1": np.eye(3, 4), "ret": 1}
    calibration = stereo_cameras("a", extra | pair(keys))
    first, second = calibration.cameras
    assert calibration.is_pair and (first.name, second.name) == ("left", "right")
    assert np.array_equal(first.pose, np.eye(3, 4))
    assert np.array_equal(second.pose, np.hstack([R, T]))
    assert (first.lens["fl_x"], first.lens["cx"], first.lens["k6"]) == (500, 310.75, 0.004)
    assert (second.lens["fl_y"], second.lens["cy"], second.lens["k3"]) == (495, 250.5, -0.005)
    assert (first.lens["w"], second.lens["h"]) == (0, 0)
    assert has_stereo_lenses(pair(keys)) and has_stereo_pose(pair(keys))


def test_a_rotation_vector_and_the_size_are_read():
    vector = Rotation.from_matrix(R).as_rotvec()
    values = pair() | {"R": vector, "image_size": np.array([640, 480]), "k1": np.array(-0.05)}
    first, second = stereo_cameras("a", values).cameras
    assert second.pose[:, :3] == pytest.approx(R, abs=1e-12)
    # A coefficient k1 is not the matrix K1.
    assert (first.lens["w"], first.lens["h"], first.lens["fl_x"]) == (640, 480, 500)


def test_coefficients_are_counted_as_opencv_counts_them():
    four = pair() | {"D1": D2[0, :4], "D2": np.append(D1, np.zeros(6))}
    first, second = stereo_cameras("a", four).cameras
    assert first.lens["camera_model"] == "OPENCV" and first.lens["p2"] == 0.003
    assert second.lens["camera_model"] == "FULL_OPENCV" and second.lens["k6"] == 0.004
    # Four of a fisheye are k1 to k4.
    both = pair() | {"D1": D2[0, :4], "D2": D2[0, :4]}
    for camera in stereo_cameras("a", both, name="a_fisheye.npz").cameras:
        assert camera.lens["camera_model"] == "OPENCV_FISHEYE" and camera.lens["k4"] == 0.003


def test_one_value_under_two_names_must_be_one():
    assert stereo_cameras("a", pair() | {"mtxL": K1, "mtxR": K2, "rot": R}).cameras
    with pytest.raises(PrepareError, match="a: must hold two camera matrices .* got mtxL and mtxR"):
        stereo_cameras("a", pair() | {"mtxL": 2 * K1, "mtxR": K2})
    with pytest.raises(PrepareError, match="a: R and rot must not differ"):
        stereo_cameras("a", pair() | {"rot": R.T})
    with pytest.raises(PrepareError, match="a: must hold two camera matrices .* got K1 and K2"):
        stereo_cameras("a", pair() | {"K0": K2})


THIN_PRISM = np.append(D1, [0.1, 0, 0, 0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K2": None}, r"f: must hold two camera matrices .* got K1 of one camera alone. Save all"),
        ({"K1": None, "K2": None}, "f: must hold two camera matrices .* got D1, D2, R, T. Save"),
        ({"D2": None}, "f: must hold two distortion coefficients .* got D1 of one camera alone"),
        ({"R": None}, "f: must hold the rotation R from the first camera .* got K1, D1, K2, D2, T"),
        ({"T": None}, "f: must hold the translation T .* R1, R2, P1, P2 and Q of a rectification"),
        ({"K1": K1[:2]}, "f: K1 must be 9 finite numbers, got 6. Save"),
        ({"D2": D2[:, :3]}, "f: D2 must be 4 or 5 or 8 or 12 or 14 finite numbers, got 3"),
        ({"T": [0, np.nan, 1]}, "f: T must be 3 finite numbers, got .0.0, nan, 1.0"),
        ({"T": [0, 0, 0]}, "f: T must not be zero"),
        ({"R": np.diag([1, 1, 2])}, "f: R must be a rotation .rows of length 1"),
        ({"R": np.diag([1, 1, -1])}, "f: R must be a rotation without a reflection"),
        ({"K2": -K2}, "f: camera right must have positive focal lengths"),
        ({"K1": K1.T}, "f: the matrix of camera left must end .* Is it transposed"),
        ({"D1": THIN_PRISM}, "f: camera left must have at most 8 distortion coefficients, got 12"),
        ({"size": [640.5, 480]}, "f: the size of camera left must be two whole numbers"),
    ],
)
def test_a_wrong_value_is_named(change, message):
    values = {key: value for key, value in (pair() | change).items() if value is not None}
    with pytest.raises(PrepareError, match=message):
        stereo_cameras("f", values)


def test_keys_of_one_camera_are_of_no_pair():
    for keys in (["mtx", "dist", "R", "T"], ["K1", "D1"], ["R1", "T1", "K2"]):
        assert not (has_stereo_lenses(keys) and has_stereo_pose(keys))
