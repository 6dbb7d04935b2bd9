"""NumPy's .npz files with one array of each value, of all cameras."""

import numpy as np
import pytest
from quads import arc

from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


POSES = np.array(arc(5))
NAMES = ["a", "b", "c", "d", "e"]
VALUES = {
    "K": np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]]) * np.ones((5, 1, 1)),
    "R": POSES[:, :, :3],
    "T": POSES[:, :, 3],
    "dist": np.arange(25.0).reshape(5, 5) / 100,
    "ret": np.float64(0.3),
}


def write(path, **changes):
    np.savez(path, **{k: v for k, v in (VALUES | changes).items() if v is not None})
    return path


@pytest.mark.parametrize("key", ["names", "camera_names"])
def test_cameras_are_read_if_they_have_names(tmp_path, key):
    path = write(tmp_path / "a.npz", **{key: NAMES}, image_size=[640, 480])
    for place in (path, tmp_path):
        cameras = read_calibration(place).cameras
        assert [one.name for one in cameras] == NAMES
        for k, one in enumerate(cameras):
            assert one.pose == pytest.approx(POSES[k])
            assert (one.lens["k1"], one.lens["w"]) == (VALUES["dist"][k, 0], 640)


@pytest.mark.parametrize("shape", [(5,), (1, 5), (5, 1)])
def test_distortion_of_one_camera_is_of_all(tmp_path, shape):
    dist = np.array([0.1, 0.2, 0, 0, 0.3]).reshape(shape)
    cameras = read_calibration(write(tmp_path / "a.npz", names=NAMES, dist=dist)).cameras
    assert {(one.lens["k1"], one.lens["k3"]) for one in cameras} == {(0.1, 0.3)}


@pytest.mark.parametrize("names", [None, NAMES[:4], np.zeros(5), [NAMES]])
def test_names_of_all_are_asked_for(tmp_path, names):
    path = write(tmp_path / "a.npz", names=names)
    with pytest.raises(PrepareError, match="must hold the names of its 5 cameras .* got K, R, T"):
        read_calibration(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"names": ["a", "b", "c", "d", "a"]}, "got a twice"),
        ({"K": np.full((5, 3, 3), "x")}, "K must be finite numbers, 3 x 3 for each camera, got"),
        ({"K": np.zeros((0, 3, 3)), "names": []}, "hold the names of its 0 cameras|K must be"),
        ({"R": None}, "camera a has no R"),
        ({"K": VALUES["K"] * np.nan}, "K must be finite numbers, 3 x 3 for each camera, got .*nan"),
        ({"T": VALUES["T"] * 1e300}, "camera a must have finite numbers of at most"),
        ({"R": -VALUES["R"]}, "rotation of camera a must have determinant 1"),
    ],
)
def test_a_wrong_value_is_named(tmp_path, changes, message):
    path = write(tmp_path / "a.npz", **({"names": NAMES} | changes))
    with pytest.raises(PrepareError, match=message):
        read_calibration(path)


def test_arrays_of_another_kind_are_told_what_is_read(tmp_path):
    np.savez(tmp_path / "a.npz", cam1=np.eye(3, 4), cam2=np.eye(3, 4))
    with pytest.raises(PrepareError, match="must hold K1, .* of two cameras, .* got cam1, cam2"):
        read_calibration(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz")
    with pytest.raises(PrepareError, match="of two cameras, .* got nothing"):
        read_calibration(tmp_path / "a.npz")


def test_stereo_vision_names_are_a_pair(tmp_path):
    matrix = VALUES["K"][0]
    values = {"cam_mats_left": matrix, "cam_mats_right": matrix, "rot_mat": np.eye(3)}
    values |= {f"dist_coefs_{side}": np.zeros((1, 5)) for side in ("left", "right")}
    np.savez(tmp_path / "a.npz", **values, trans_vec=[[-0.4], [0], [0]])
    calibration = read_calibration(tmp_path / "a.npz")
    assert calibration.is_pair and calibration.cameras[1].pose[0, 3] == -0.4
