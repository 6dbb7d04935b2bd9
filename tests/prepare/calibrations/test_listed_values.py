"""Files with one list of each value, of all cameras in an order."""

import json

import numpy as np
import pytest
import yaml
from quads import arc

from gaussray.prepare.calibrations.assign import assign_cameras
from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


COUNT = 12
POSES = arc(COUNT)
MATRIX = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
BEND = [-0.2, 0.3, -0.001, 0.002, -0.4]


def lists(**others):
    """Lists as ZJU-MoCap's JSON has them; focal lengths tell the cameras apart."""
    return {
        "K": [(MATRIX + np.diag([k, 0.0, 0.0])).tolist() for k in range(COUNT)],
        "R": [pose[:, :3].tolist() for pose in POSES],
        "T": [pose[:, 3:].tolist() for pose in POSES],
        "D": [np.array(BEND)[:, None].tolist() for _ in range(COUNT)],
    } | others


def written(tmp_path, content, name="K, R, T, D cams_only.json"):
    path = tmp_path / name
    path.write_text(json.dumps(content) if name.endswith("json") else yaml.safe_dump(content))
    return path


def sources(tmp_path, *numbers):
    return [
        Source(f"cam{k}", tmp_path / f"cam{k}.mp4", (), np.zeros(3), ((640, 480),)) for k in numbers
    ]


@pytest.mark.parametrize("outer", [lambda x: x, lambda x: {"cams": {"20190823": x}}])
@pytest.mark.parametrize("name", ["K, R, T, D cams_only.json", "cameras.yaml"])
def test_cameras_without_names_are_those_of_the_input_in_natural_order(
    tmp_path, capsys, outer, name
):
    calibration = read_calibration(written(tmp_path, outer(lists()), name))
    # As a folder lists them: cam10 before cam2.
    given = sources(tmp_path, *sorted(range(1, COUNT + 1), key=str))
    cameras, findings, _ = assign_cameras(calibration, given)
    assert not findings
    for k in range(COUNT):
        camera = cameras[f"cam{k + 1}"]
        np.testing.assert_allclose(camera.pose, POSES[k], atol=1e-9)
        assert camera.lens["fl_x"] == 500.0 + k and camera.lens["k3"] == -0.4
    assert "in the order cam1, cam2, cam3, ..., cam12." in capsys.readouterr().out


def test_other_keys_of_the_same_lists(tmp_path):
    values = lists()
    values = {"K": values["K"], "R": values["R"], "t": values["T"], "dist": values["D"]}
    plain = read_calibration(written(tmp_path, lists()))
    other = read_calibration(written(tmp_path, values | {"date": "2019", "extra": [{}, [1]]}))
    assert [camera.lens for camera in other.cameras] == [camera.lens for camera in plain.cameras]


def test_another_number_of_cameras_is_refused_unless_they_have_names(tmp_path):
    some = sources(tmp_path, 3, 7)
    calibration = read_calibration(written(tmp_path, lists()))
    with pytest.raises(
        PrepareError, match="has 12 cameras without names.* got 2 cameras there.* cam1,cam2 above"
    ):
        assign_cameras(calibration, some)
    with pytest.raises(PrepareError, match="poses.lens=.* must name its cameras, got 12 without"):
        read_lenses(written(tmp_path, lists()))
    names = [f"cam{COUNT - k}" for k in range(COUNT)]
    named = written(tmp_path, {"cams": {"x": lists(names=names)}})
    cameras, _, _ = assign_cameras(read_calibration(named), some)
    assert {name: one.lens["fl_x"] for name, one in cameras.items()} == {"cam3": 509, "cam7": 505}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lists(R=lists()["R"][:-1]), "got 12 of K, 11 of R, 12 of T, 12 of D"),
        (lists(D=[[0.1], [0.1, 0.2]] * 6), "D must be a list of as many numbers for each camera"),
        ({"a": lists(), "b": lists()}, "must hold the lists of one rig, got those of a, b"),
        (lists(names=["cam1"]), "must hold the names of its 12 cameras"),
        ({"K": lists()["K"]}, "must have a camera with a pose, got none"),
    ],
)
def test_lists_that_make_no_rig_are_refused(tmp_path, content, words):
    with pytest.raises(PrepareError, match=words):
        read_calibration(written(tmp_path, content))


def test_a_matrix_of_sixteen_numbers_beside_camera_intrinsic_is_the_pose(tmp_path):
    content = {
        f"Camera{k + 1}": {
            "CameraIntrinsic": MATRIX.ravel().tolist(),
            "CameraMatrix": np.vstack([pose, [0, 0, 0, 1]]).ravel()[:count].tolist(),
            **{"CameraNumber": k + 1, "DistCoeff": BEND, "fps": 60.0},
            **{"FrameHeight": 480.0, "FrameWidth": 640.0},
        }
        for k, (pose, count) in enumerate(zip(POSES[:2], (16, 12), strict=True))
    }
    calibration = read_calibration(written(tmp_path, content, "camera_model.json"))
    for camera, pose in zip(calibration.cameras, POSES, strict=False):
        np.testing.assert_allclose(camera.pose, pose, atol=1e-9)
        size = camera.lens["w"], camera.lens["h"], camera.lens["fl_y"], camera.lens["k3"]
        assert size == (640, 480, 505.0, -0.4)
