"""NumPy's .npz files with one array of each value, of all cameras."""

import numpy as np
import pytest
from quads import arc
from scipy.spatial.transform import Rotation

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


@pytest.mark.parametrize("shape", [(5,), (5, 1)])
def test_sides_are_of_each_camera_or_of_all(tmp_path, shape):
    columns = np.array([1280, 1280, 640, 640, 640]).reshape(shape)
    for height in (720, np.full(shape, 720), [720]):
        path = write(tmp_path / "a.npz", names=NAMES, width=columns, height=height)
        lenses = [one.lens for one in read_calibration(path).cameras]
        assert [lens["w"] for lens in lenses] == columns.ravel().tolist()
        assert {lens["h"] for lens in lenses} == {720}


def test_names_may_be_bytes(tmp_path):
    path = write(tmp_path / "a.npz", names=np.array([name.encode() for name in NAMES]))
    assert [one.name for one in read_calibration(path).cameras] == NAMES


@pytest.mark.parametrize("shape", [(5, 3), (5, 3, 1)])
def test_poses_of_cameras_may_have_names_of_many(tmp_path, shape):
    turns = Rotation.from_matrix(VALUES["R"]).as_rotvec().reshape(shape)
    changes = {"R": None, "T": None, "rvecs": turns, "tvecs": VALUES["T"].reshape(shape)}
    cameras = read_calibration(write(tmp_path / "a.npz", names=NAMES, **changes)).cameras
    assert np.array([one.pose for one in cameras]) == pytest.approx(POSES)


FOUR = np.array([0.1, 0.2, 0.3, 0.4]) * np.ones((5, 1))


def models(path):
    return [one.lens["camera_model"] for one in read_calibration(path).cameras]


def test_four_coefficients_are_a_fisheyes_if_the_file_is_called_so(tmp_path, capsys):
    path = write(tmp_path / "my_Fisheye.npz", names=NAMES, dist=FOUR)
    assert models(path) == ["OPENCV_FISHEYE"] * 5
    assert read_calibration(path).cameras[3].lens["k3"] == 0.3
    told = f"{path}: four distortion coefficients are taken as OpenCV's fisheye model."
    assert told in capsys.readouterr().out
    assert models(write(tmp_path / "fisheye.npz", names=NAMES)) == ["FULL_OPENCV"] * 5
    assert models(write(path, names=NAMES, dist=FOUR, fisheye=False)) == ["OPENCV"] * 5
    assert models(write(tmp_path / "a.npz", names=NAMES, dist=FOUR)) == ["OPENCV"] * 5


@pytest.mark.parametrize(
    "label",
    [
        {"fisheye": [True, False, True, True, True]},
        {"distortion_model": ["fisheye", "radtan", *["equidistant"] * 3]},
        {"camera_model": np.array([b"fisheye", b"pinhole", *[b"fisheye"] * 3])},
    ],
)
def test_each_camera_may_have_a_model(tmp_path, label):
    fisheye = "OPENCV_FISHEYE"
    path = write(tmp_path / "a.npz", names=NAMES, dist=FOUR, **label)
    assert models(path) == [fisheye, "OPENCV", fisheye, fisheye, fisheye]
    (key,) = label
    for one in ("fisheye", ["fisheye"]):
        path = write(tmp_path / "a.npz", names=NAMES, dist=FOUR, distortion_model=one)
        assert models(path) == [fisheye] * 5
    path = write(tmp_path / "a.npz", names=NAMES, dist=FOUR, **{key: label[key][:3]})
    with pytest.raises(PrepareError, match=f"{key} must be one value, or one for each of the 5"):
        read_calibration(path)


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


def test_one_rotation_beside_three_cameras_is_refused(tmp_path):
    values = {key: value[:3] for key, value in VALUES.items() if np.ndim(value)}
    path = write(tmp_path / "a.npz", **values, names=NAMES[:3])
    assert len(read_calibration(path).cameras) == 3
    path = write(tmp_path / "a.npz", **(values | {"R": np.eye(3)}), names=NAMES[:3])
    with pytest.raises(PrepareError, match="R must be 3 x 3 for each of the 3 cameras, got 3 x 3"):
        read_calibration(path)
    vectors = {"R": None, "rvecs": np.zeros((3, 3))}
    cameras = read_calibration(write(path, **(values | vectors), names=NAMES[:3])).cameras
    assert all((one.pose[:, :3] == np.eye(3)).all() for one in cameras)
