"""JSON files with K, R and t of each camera, as scripts around OpenCV write them."""

import json

import numpy as np
import pytest
from quads import arc
from scipy.spatial.transform import Rotation

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
    ],
)
def test_cameras_are_read_from_an_object_and_a_list(tmp_path, capsys, keys, vector):
    cameras = [camera(pose, keys, vector) for pose in POSES]
    by_name = dict(zip(NAMES, cameras, strict=True))
    for content in (by_name, {"cameras": by_name}):
        check(read_calibration(write(tmp_path / "a.json", content)).cameras)
    sized = [{"cam": name, "width": 640, "height": 480, **one} for name, one in by_name.items()]
    check(read_calibration(write(tmp_path / "a.json", sized)).cameras, size=(640, 480))
    assert "taken as OpenCV's, from world to camera" in capsys.readouterr().out


def test_a_file_for_each_camera_is_read_if_their_folder_is_given(tmp_path, capsys):
    for name, pose in zip(NAMES, POSES, strict=True):
        path = write(tmp_path / f"{name}.json", camera(pose))
    write(tmp_path / "settings.json", {"rate": 30})
    check(read_calibration(tmp_path).cameras)
    assert "cam01, cam02, cam03 are each read from" in capsys.readouterr().out
    with pytest.raises(PrepareError, match=f"got one. .* poses.calibration={tmp_path}."):
        read_calibration(path)


def test_a_camera_without_pose_is_left_out_with_the_reason(tmp_path):
    content = {"a": camera(POSES[0]), "b": {"K": MATRIX}, "board": {"rows": 6}}
    calibration = read_calibration(write(tmp_path / "a.json", content))
    assert [one.name for one in calibration.cameras] == ["a"]
    assert calibration.left_out == {"b": "has no R and t"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dist": "none"}, "dist of camera a must be numbers .* got none"),
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
