"""Results of cv2.stereoCalibrate in .npz files, of which nothing is unpickled."""

import re

import numpy as np
import pytest

from gaussray.io.safe.limits import Limits, limit, limits
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.calibrations.stereo_npz import is_stereo_npz, read_calibration_npz
from gaussray.prepare.errors import PrepareError


MATRIX = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
VALUES = {
    **{"mtxL": MATRIX, "distL": np.array([[-0.05, 0.02, 0.001, -0.002, 0.01]])},
    **{"mtxR": 2 * MATRIX - np.diag([0, 0, 1]), "distR": np.zeros((1, 5))},
    **{"R": np.diag([1.0, -1, -1]), "T": np.array([[-0.4], [0.02], [0.1]]), "ret": 0.3},
}


def write(path, **changes):
    values = {key: value for key, value in (VALUES | changes).items() if value is not None}
    np.savez_compressed(path, **values)
    return path


def test_the_cameras_of_a_file_and_of_its_folder(tmp_path):
    path = write(tmp_path / "stereo_calibration.npz", map1=np.zeros((4, 5, 2)))
    np.savez(tmp_path / "keypoints.npz", points=np.zeros((7, 2)))
    assert is_stereo_npz(path) and not is_stereo_npz(tmp_path / "keypoints.npz")
    for place in (path, tmp_path):
        calibration = read_calibration(place)
        first, second = calibration.cameras
        assert calibration.is_pair and np.array_equal(first.pose, np.eye(3, 4))
        assert np.array_equal(second.pose, np.hstack([VALUES["R"], VALUES["T"]]))
        assert (first.lens["fl_x"], first.lens["cy"], first.lens["k3"]) == (500, 243, 0.01)
        assert (second.lens["fl_y"], second.lens["cx"], second.lens["k1"]) == (1010, 621, 0)


def test_four_coefficients_are_of_a_fisheye_if_the_file_says_so(tmp_path, capsys):
    four = {"distL": np.array([[0.1], [0.2], [0.3], [0.4]]), "distR": np.zeros((4, 1))}
    first, _ = read_calibration_npz(write(tmp_path / "stereo_fisheye.npz", **four)).cameras
    assert first.lens["camera_model"] == "OPENCV_FISHEYE" and first.lens["k3"] == 0.3
    assert "taken as OpenCV's fisheye model" in capsys.readouterr().out
    first, _ = read_calibration_npz(write(tmp_path / "stereo.npz", **four)).cameras
    assert first.lens["camera_model"] == "OPENCV" and first.lens["p1"] == 0.3
    mixed = write(tmp_path / "mixed_fisheye.npz", **four | {"distR": np.zeros(5)})
    with pytest.raises(PrepareError, match="distL and distR must be four numbers each"):
        read_calibration_npz(mixed)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"R": None}, "a.npz: must hold the rotation R"),
        ({"T": np.zeros((3, 2))}, "a.npz: T must be 3 finite numbers, got 6"),
        ({"distR": np.zeros(5, complex)}, "a.npz: distR must be 4 or 5 or 8 or 12 or 14 finite"),
        ({"mtxR": np.full((3, 3), "x")}, "a.npz: mtxR must be 9 finite numbers"),
        ({"R": np.array([{}], object)}, "'R.npy': no array of NumPy: numbers of the kind object"),
    ],
)
def test_a_wrong_value_is_named(tmp_path, changes, message):
    path = write(tmp_path / "a.npz", **changes)
    for place in (path, tmp_path):
        with pytest.raises(PrepareError, match=re.escape(message)):
            read_calibration(place)


def test_python_objects_and_truncated_files_are_told_how_to_save(tmp_path):
    path = write(tmp_path / "a.npz", rvecs=np.array([[0.1], None], object))
    with pytest.raises(PrepareError, match=r"plain numbers \(no Python objects\). Save it again"):
        read_calibration(path)
    path.write_bytes(write(path).read_bytes()[:-40])
    with pytest.raises(PrepareError, match=r"a.npz: .* Save it again with numpy.savez"):
        read_calibration(path)
    assert not is_stereo_npz(path)


def test_arrays_beyond_the_limit_are_refused(tmp_path):
    path, before = write(tmp_path / "a.npz", map1=np.zeros(10_000)), limits()
    limit(Limits(arrays=1e-5))
    try:
        with pytest.raises(ValueError, match="limits.arrays"):
            read_calibration(path)
    finally:
        limit(before)
