"""Poses of cameras in JSON files: R and t, or one matrix under any of its names."""

import json

import numpy as np
import pytest
from quads import arc
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.opencv_pose import found_pose, world_to_camera
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


POSES = arc(3)
NAMES = ("cam01", "cam02", "cam03")
MATRIX = [[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]]
DISTORTION = [-0.05, 0.02, 0.001, -0.002, 0.0]


def square(pose):
    return np.vstack([pose, [0, 0, 0, 1]])


def write(path, content):
    path.write_text(json.dumps(content))
    return path


def rig(key, matrices, **more):
    pairs = zip(NAMES, matrices, strict=True)
    return {name: {"K": MATRIX, key: matrix, **more} for name, matrix in pairs}


def check(cameras):
    assert [one.name for one in cameras] == list(NAMES)
    for one, pose in zip(cameras, POSES, strict=True):
        assert one.pose == pytest.approx(pose, abs=1e-9)


@pytest.mark.parametrize("key", ["RT", "extrinsic", "extrinsics", "extrinsic_matrix", "w2c"])
@pytest.mark.parametrize("shape", [(3, 4), (12,), (4, 4), (16,)])
def test_a_matrix_from_world_to_camera_is_a_pose(tmp_path, capsys, key, shape):
    rows = 4 if shape in ((4, 4), (16,)) else 3
    matrices = [square(pose)[:rows].reshape(shape).tolist() for pose in POSES]
    path = write(tmp_path / "a.json", rig(key, matrices))
    check(read_calibration(path).cameras)
    line = f"{path}: {key} is taken as OpenCV's, from world to camera.\n"
    assert capsys.readouterr().out == line


@pytest.mark.parametrize("key", ["c2w", "camera_to_world", "cam2world"])
def test_a_matrix_from_camera_to_world_is_inverted_and_told(tmp_path, capsys, key):
    matrices = [np.linalg.inv(square(pose)) for pose in POSES]
    for rows in (3, 4):
        content = rig(key, [matrix[:rows].tolist() for matrix in matrices])
        check(read_calibration(write(tmp_path / "a.json", content)).cameras)
        told = f"{key} is taken as OpenCV's, from camera to world, and inverted"
        assert told in capsys.readouterr().out


def test_of_several_poses_that_from_world_to_camera_is_taken():
    values = {
        "c2w": np.eye(4),
        "w2c": np.eye(4)[:3],
        "R": POSES[1][:, :3],
        "T": [1, 2],
        "t": POSES[1][:, 3],
    }
    found = found_pose(values)
    assert found.keys == "R and t" and not found.inverse
    assert world_to_camera("a", "b", found) == pytest.approx(POSES[1])
    assert found_pose({**values, "R": None}).keys == "w2c"
    assert found_pose({"c2w": np.eye(4)}).inverse
    assert found_pose({"R": np.eye(3), "x": [0, 0, 0]}) is None


@pytest.mark.parametrize(
    ("rotation", "translation"),
    [
        ("RotationValues", "TranslationValues"),
        ("rvec", "tvec"),
        ("rotation_vector", "translation_vector"),
    ],
)
def test_rotations_and_translations_have_other_names(tmp_path, rotation, translation):
    turns = [Rotation.from_matrix(pose[:, :3]).as_rotvec().tolist() for pose in POSES]
    content = rig(rotation, turns)
    for one, pose in zip(content.values(), POSES, strict=True):
        one[translation] = pose[:, 3:].tolist()
    check(read_calibration(write(tmp_path / "a.json", content)).cameras)


@pytest.mark.parametrize(
    "value", [[0.0] * 11, [0.0] * 15 + [np.nan], "eye", None, {}, [[1], [2, 3]]]
)
def test_a_matrix_of_other_numbers_is_no_pose_and_told(tmp_path, value):
    path = write(tmp_path / "a.json", rig("RT", [value] * 3, dist=DISTORTION))
    with pytest.raises(PrepareError, match=r"cam01 has no R .* nor RT \(12 or 16\), got K, RT, di"):
        read_calibration(path)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (square(POSES[0]).T, "RT of camera cam01 must end with the row 0 0 0 1, .* Is it transp"),
        (2 * square(POSES[0])[:3], "camera cam01 must have positive focal lengths and a rotation"),
        (np.diag([1.0, 1, -1, 1]), "rotation of camera cam01 must have determinant 1, got -1: one"),
        (1e300 * np.ones((3, 4)), "camera cam01 must have finite numbers of at most 1e.12, got 1e"),
        (
            np.column_stack([np.eye(3), [0, 0, 1e13]]),
            "finite numbers of at most 1e.12, got -?1e.13",
        ),
    ],
)
@pytest.mark.parametrize("key", ["RT", "c2w"])
def test_a_matrix_that_is_no_pose_is_refused(tmp_path, matrix, message, key):
    path = write(tmp_path / "a.json", rig(key, [matrix.tolist()] * 3))
    with pytest.raises(PrepareError, match=message.replace("RT of", f"{key} of")):
        read_calibration(path)


@pytest.mark.parametrize(
    ("matrix", "asked"), [(np.zeros((4, 4)), False), (square(POSES[0]).T, True)]
)
def test_only_a_transposed_matrix_is_asked_whether_it_is(tmp_path, matrix, asked):
    path = write(tmp_path / "a.json", rig("RT", [matrix.tolist()] * 3))
    with pytest.raises(PrepareError, match="must end with the row 0 0 0 1, got .* Write") as error:
        read_calibration(path)
    assert ("Is it transposed?" in str(error.value)) == asked


def test_poses_of_one_view_of_a_board_are_no_poses_of_cameras(tmp_path):
    one = {
        "mtx": MATRIX,
        "dist": DISTORTION,
        "rvecs": [[[0.1], [0], [0]]],
        "tvecs": [[[0], [0], [1]]],
    }
    for name in NAMES:
        write(tmp_path / f"{name}.json", one)
    with pytest.raises(PrepareError, match="must hold one calibration, got cam01.json, cam02.json"):
        read_calibration(tmp_path)
    with pytest.raises(PrepareError, match="camera cam01 has no R .* got mtx, dist, rvecs, tvecs"):
        read_calibration(write(tmp_path / "all.json", dict.fromkeys(NAMES, one)))


def test_a_rotation_vector_of_huge_numbers_is_refused(tmp_path):
    content = rig("rvec", [[1e300, 0, 0]] * 3, tvec=[0, 0, 1])
    with pytest.raises(PrepareError, match="camera cam01 must have finite numbers .* got nan"):
        read_calibration(write(tmp_path / "a.json", content))


def test_a_mirrored_rig_is_told_which_axis_to_negate(tmp_path):
    for flip in (np.diag([-1.0, 1, 1]), np.diag([1.0, 1, -1])):
        path = write(
            tmp_path / "a.json",
            rig("R", [(pose[:, :3] @ flip).tolist() for pose in POSES], t=[0, 0, 1]),
        )
        with pytest.raises(PrepareError, match="got -1: one axis is mirrored. Negate it") as error:
            read_calibration(path)
        assert "\n" not in str(error.value)


def split(**more):
    matrices = [square(pose).tolist() for pose in POSES]
    return {
        "intrinsics": dict.fromkeys(NAMES, MATRIX),
        "extrinsics": dict(zip(NAMES, matrices, strict=True)),
        **more,
    }


def test_intrinsics_and_extrinsics_may_be_objects_of_cameras(tmp_path):
    path = tmp_path / "a.json"
    check(read_calibration(write(path, split())).cameras)
    content = split(distortions=dict.fromkeys(NAMES, DISTORTION), image_size=[640, 480])
    cameras = read_calibration(write(path, content)).cameras
    check(cameras)
    assert (cameras[2].lens["k1"], cameras[2].lens["w"]) == (-0.05, 640)
    blocks = split(intrinsics=dict.fromkeys(NAMES, {"K": MATRIX, "dist": DISTORTION}))
    blocks["extrinsics"] = {
        name: {"R": pose[:, :3].tolist(), "t": pose[:, 3].tolist()}
        for name, pose in zip(NAMES, POSES, strict=True)
    }
    cameras = read_calibration(write(path, blocks)).cameras
    check(cameras)
    assert cameras[0].lens["k1"] == -0.05


def test_a_list_of_cameras_with_resolution_may_have_a_matrix(tmp_path):
    cameras = [
        {"name": name, "K": MATRIX, "RT": pose.tolist(), "resolution": [640, 480]}
        for name, pose in zip(NAMES, POSES, strict=True)
    ]
    check(read_calibration(write(tmp_path / "a.json", {"cameras": cameras})).cameras)


def test_separate_objects_that_do_not_fit_are_refused(tmp_path):
    path = tmp_path / "a.json"
    del (content := split())["extrinsics"]["cam03"]
    calibration = read_calibration(write(path, content))
    assert list(calibration.left_out) == ["cam03"]
    with pytest.raises(PrepareError, match="camera cam01 has no R"):
        read_calibration(write(path, split(extrinsics={"other": np.eye(4).tolist()})))
    with pytest.raises(PrepareError, match="distParams of camera cam01 is not read"):
        read_calibration(write(path, split(distParams=dict.fromkeys(NAMES, DISTORTION))))
    with pytest.raises(PrepareError, match="camera 1 has no R"):
        read_calibration(write(path, {"intrinsics": [MATRIX] * 2, "extrinsics": {}}))
