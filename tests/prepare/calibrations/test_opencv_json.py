"""JSON files with K, R and t of each camera, as scripts around OpenCV write them."""

import json

import numpy as np
import pytest
from quads import arc
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


POSES = arc(3)
NAMES = ("cam01", "cam02", "cam03")
MATRIX = [[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]]


def camera(pose, keys="K R t dist", vector=False):
    turn = Rotation.from_matrix(pose[:, :3]).as_rotvec() if vector else pose[:, :3]
    values = (MATRIX, turn.tolist(), pose[:, 3:].tolist(), [[-0.05, 0.02, 0.001, -0.002, 0.0]])
    return dict(zip(keys.split(), values, strict=False))


def write(path, content):
    path.write_text(json.dumps(content))
    return path


def check(cameras, size=(0, 0)):
    assert [one.name for one in cameras] == list(NAMES)
    for one, pose in zip(cameras, POSES, strict=True):
        assert one.pose == pytest.approx(pose, abs=1e-9)
        assert (one.lens["fl_y"], one.lens["cx"], one.lens["k1"]) == (505.0, 310.75, -0.05)
        assert (one.lens["w"], one.lens["h"]) == size


@pytest.mark.parametrize(
    ("keys", "vector"),
    [
        ("K R t dist", False),
        ("k r T distortion", False),
        ("camera_matrix rotation translation D", True),
        ("intrinsics rvec tvec d", True),
        ("K R t distCoeffs", False),
        ("K R t dist_coefs", False),
        ("K R t distortion_coefficients", False),
    ],
)
def test_cameras_are_read_from_an_object_and_a_list(tmp_path, capsys, keys, vector):
    cameras = [camera(pose, keys, vector) for pose in POSES]
    by_name = dict(zip(NAMES, cameras, strict=True))
    named = [{"name": name, **one} for name, one in by_name.items()]
    for content in (by_name, {"cameras": by_name}, {"cameras": named}):
        check(read_calibration(write(tmp_path / "a.json", content)).cameras)
    sized = [{"cam": name, "width": 640, "height": 480, **one} for name, one in by_name.items()]
    check(read_calibration(write(tmp_path / "a.json", sized)).cameras, size=(640, 480))
    assert "taken as OpenCV's, from world to camera" in capsys.readouterr().out


def test_a_file_for_each_camera_is_read_if_their_folder_is_given(tmp_path, capsys):
    for name, pose in zip(NAMES, POSES, strict=True):
        path = write(tmp_path / f"{name}.json", camera(pose))
    write(tmp_path / "settings.json", {"rate": 30})
    check(read_calibration(tmp_path).cameras)
    told = capsys.readouterr().out
    assert "cam01, cam02, cam03 are each read from" in told and "settings.json is not." in told
    with pytest.raises(PrepareError, match=f"got one. .* poses.calibration={tmp_path}."):
        read_calibration(path)


def test_a_file_of_all_cameras_is_read_instead_of_those_of_single_ones(tmp_path, capsys):
    for name, pose in zip(NAMES, POSES, strict=True):
        write(tmp_path / f"{name}.json", camera(pose, "K R t"))
    cameras = dict(zip(NAMES, map(camera, POSES), strict=True))
    write(tmp_path / "all.json", cameras)
    check(read_calibration(tmp_path).cameras)
    assert "all.json is read, and not the files of single" in capsys.readouterr().out
    write(tmp_path / "copy.json", cameras)
    with pytest.raises(PrepareError, match="must hold one calibration of all .* copy.json, cam01"):
        read_calibration(tmp_path)


def test_a_folder_with_the_file_of_one_camera_is_not_told_to_name_itself(tmp_path):
    write(tmp_path / "cam01.json", camera(POSES[0]))
    with pytest.raises(PrepareError, match="must hold .* a file for each camera") as caught:
        read_calibration(tmp_path)
    assert "give their folder" not in str(caught.value)


def test_a_camera_without_pose_is_left_out_with_the_reason(tmp_path):
    content = {"a": camera(POSES[0]), "b": {"K": MATRIX}, "board": {"rows": 6}}
    calibration = read_calibration(write(tmp_path / "a.json", content))
    assert [one.name for one in calibration.cameras] == ["a"]
    assert calibration.left_out == {
        "b": "has no R (3 or 9 numbers) and t (3 numbers), nor RT (12 or 16)"
    }


@pytest.mark.parametrize("change", [{"R": [1, 0, 0, 0]}, {"t": np.eye(4).tolist()}])
def test_a_pose_of_other_numbers_is_told(tmp_path, change):
    one = {**camera(POSES[0]), **change}
    for content in ({"a": one}, one):
        path = write(tmp_path / "a.json", content)
        with pytest.raises(PrepareError, match=r"has no R \(3 or 9 numbers\) and t \(3 numbers\)"):
            read_calibration(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dist": "none"}, "camera a: dist must be 1 or 2 or 4 .* got none"),
        ({"dist": True}, "camera a: dist must be 1 or 2 or 4 .* got True"),
        ({"distParams": [0.1]}, "a.json: distParams of camera a is not read"),
        ({"K": np.transpose(MATRIX).tolist()}, "matrix of camera a .* Is it transposed"),
        ({"size": [640.5, 480]}, "size of camera a must be two whole numbers .* 640.5 x 480"),
        ({"size": [640, 2e6]}, "size of camera a must be two whole numbers from 1 to 1000000"),
        ({"size": "VGA"}, "camera a: size must be 2 finite numbers, got VGA"),
        ({"width": 640}, "camera a: the size must be two whole numbers .*640"),
        ({"R": np.diag([1, 1, 2]).tolist()}, "camera a must have positive focal lengths and a rot"),
    ],
)
def test_a_wrong_value_is_named(tmp_path, change, message):
    path = write(tmp_path / "a.json", {"a": {**camera(POSES[0]), **change}})
    with pytest.raises(PrepareError, match=message):
        read_calibration(path)


def test_two_cameras_of_one_name_in_a_list_are_refused(tmp_path):
    path = write(tmp_path / "a.json", [{"id": 1, **camera(pose)} for pose in POSES])
    with pytest.raises(PrepareError, match="got 1 twice"):
        read_calibration(path)


@pytest.mark.parametrize("name", [{}, {"id": True}, {"id": None}])
def test_a_camera_of_a_list_without_name_is_told(tmp_path, name):
    cameras = [{"name": "a", **camera(POSES[0])}, {**name, **camera(POSES[1])}]
    path = write(tmp_path / "a.json", cameras)
    with pytest.raises(PrepareError, match=r"camera 2 of the list must have a name \(name, cam"):
        read_calibration(path)


def test_a_list_with_resolution_may_have_distortion_under_any_name(tmp_path):
    cameras = [
        {"name": name, "resolution": [640, 480], **camera(pose)}
        for name, pose in zip(NAMES, POSES, strict=True)
    ]
    path = write(tmp_path / "a.json", {"cameras": cameras})
    check(read_calibration(path).cameras, size=(640, 480))
    cameras[1]["distCoef"] = [0.0] * 5
    with pytest.raises(PrepareError, match="dist of camera cam01 is not read"):
        read_calibration(write(path, {"cameras": cameras}))


@pytest.mark.parametrize("value", [None, False, {}, [], "", [[]]])
def test_no_distortion_is_zeros(tmp_path, value):
    one = {**camera(POSES[0], "K R t"), "distortion": value}
    (found,) = read_calibration(write(tmp_path / "a.json", {"a": one})).cameras
    assert [found.lens[key] for key in ("k1", "k2", "p1", "p2")] == [0, 0, 0, 0]
    lens = read_lenses(write(tmp_path / "b.json", {"K": MATRIX, "distortion": value}))["b"]
    assert lens["camera_model"] == "OPENCV" and not lens.get("k1")
