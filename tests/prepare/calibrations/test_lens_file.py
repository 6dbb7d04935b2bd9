"""The lens of one camera in the formats of other programs, without a pose."""

import json
import re

import numpy as np
import pytest

from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.errors import PrepareError


MATRIX = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
FOUR = [500.0, 505.0, 310.25, 242.5]
DISTORTION = [-0.28, 0.07, 0.0002, -0.002]
LENS = {
    "camera_model": "OPENCV",
    **{"w": 640, "h": 480, "fl_x": 500.0, "fl_y": 505.0, "cx": 310.75, "cy": 243.0},
    **dict(zip(("k1", "k2", "p1", "p2"), DISTORTION, strict=True)),
}
EUROC = f"""#Default sensor.
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: {np.eye(4).ravel().tolist()}
rate_hz: 20
resolution: [640, 480]
camera_model: pinhole
intrinsics: {FOUR} #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: {DISTORTION}
"""
KALIBR = f"""cam0:
  camera_model: pinhole
  distortion_coeffs: {DISTORTION}
  distortion_model: radtan
  intrinsics: {FOUR}
  resolution: [640, 480]
"""
ROS = f"""image_width: 640
image_height: 480
camera_name: narrow
camera_matrix: {{rows: 3, cols: 3, data: {MATRIX.ravel().tolist()}}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: {[*DISTORTION, 0.0]}}}
rectification_matrix: {{rows: 3, cols: 3, data: {np.eye(3).ravel().tolist()}}}
"""
STORAGE = f"""%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: {MATRIX.ravel().tolist()}
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: {[*DISTORTION, 0.0]}
avg_reprojection_error: 0.2
"""
XML = f"""<?xml version="1.0"?>
<opencv_storage>
<image_Width>640</image_Width>
<image_Height>480</image_Height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>{" ".join(map(str, MATRIX.ravel()))}</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>4</rows><cols>1</cols><dt>d</dt>
<data>{" ".join(map(str, DISTORTION))}</data></Distortion_Coefficients>
</opencv_storage>
"""
TOML = f"""[cam_0]
name = "front"
size = [640.0, 480.0]
matrix = {MATRIX.tolist()}
distortions = {DISTORTION}
fisheye = false
[metadata]
error = 0.1
"""
CALIBRATED = {"camera_matrix": MATRIX.tolist(), "dist_coeffs": [DISTORTION], "size": [640, 480]}
FILES = {
    "sensor.yaml": EUROC,
    "camchain.yaml": KALIBR,
    "camera_info.yaml": ROS,
    "out.yml": STORAGE,
    "out.xml": XML,
    "rig.toml": TOML,
    "camera.json": json.dumps(CALIBRATED),
    "one.json": json.dumps({"cameras": [{"name": "front", **CALIBRATED}]}),
    "lens.json": json.dumps(LENS),
}


@pytest.mark.parametrize("name", FILES)
def test_the_lens_of_one_camera_is_the_same_in_every_format(tmp_path, name):
    path = tmp_path / name
    path.write_text(FILES[name])
    ((camera, lens),) = read_lenses(path).items()
    assert lens | {"k3": 0.0} == LENS | {"k3": 0.0}
    named = {"camchain.yaml": "cam0", "rig.toml": "front", "one.json": "front"}
    assert camera == named.get(name, path.stem)


@pytest.mark.parametrize("keys", [("mtx", "dist"), ("cameraMatrix", "distCoeffs"), ("K", "D")])
def test_the_results_of_calibrate_camera_are_read_and_may_say_no_size(tmp_path, keys):
    path = tmp_path / "calib.npz"
    values = dict(zip(keys, (MATRIX, [DISTORTION]), strict=True))
    # The camera matrix of cv2.getOptimalNewCameraMatrix and the boards' poses are others.
    np.savez(path, **values, newcameramtx=2 * MATRIX, rvecs=np.ones((7, 3, 1)), tvecs=np.ones(3))
    (lens,) = read_lenses(path).values()
    assert lens == LENS | {"w": 0, "h": 0}


@pytest.mark.parametrize(
    "text",
    [
        KALIBR.replace("radtan", "equidistant"),
        ROS.replace("plumb_bob", "equidistant").replace(f"{DISTORTION[-1]}, 0.0]", "-0.002]"),
        TOML.replace("fisheye = false", "fisheye = true"),
    ],
)
def test_fisheyes_are_known_by_their_model(tmp_path, text):
    path = tmp_path / ("a.toml" if "matrix = " in text else "a.yaml")
    path.write_text(text)
    (lens,) = read_lenses(path).values()
    assert lens["camera_model"] == "OPENCV_FISHEYE"
    assert [lens[f"k{i}"] for i in (1, 2, 3, 4)] == DISTORTION


def test_several_cameras_keep_their_names_and_poses_do_not_count(tmp_path):
    path = tmp_path / "camchain.yaml"
    other = KALIBR.replace("cam0", "cam1").replace("500.0", "600.0")
    pose = f"  T_cn_cnm1: {np.eye(4).tolist()}\n"
    path.write_text(KALIBR + other + pose)
    lenses = read_lenses(path)
    assert [lens["fl_x"] for lens in lenses.values()] == [500, 600]
    assert list(lenses) == ["cam0", "cam1"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.yaml", KALIBR.replace("pinhole", "omni"), "a.yaml, camera cam0: must be a pinhole"),
        ("a.yaml", EUROC.replace(str(DISTORTION), "[1, 2, 3]"), "must be OpenCV's 4, 5 or 8"),
        ("a.yaml", EUROC + "k: [1, 2, 3, 4]\n", "intrinsics and k must not differ"),
        ("a.yaml", "a: 1\n", "must hold the lens of a camera"),
        ("a.json", json.dumps(CALIBRATED | {"distort": 1}), "distort of camera a.json is not read"),
        ("a.toml", "a = ", "a.toml: .*It may be"),
        ("a.mat", "", "must hold the lens of a camera, got none"),
    ],
)
def test_what_is_no_lens_is_refused_with_the_kinds_that_are(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(PrepareError, match=message):
        read_lenses(path)


def test_a_folder_is_no_lens(tmp_path):
    with pytest.raises(FileNotFoundError, match=f"poses.lens={re.escape(str(tmp_path))}: .*folder"):
        read_lenses(tmp_path)


def camera(focal=500.0, **more):
    return {"K": [[focal, 0, 320], [0, focal, 240], [0, 0, 1]], "dist": [0, 0, 0, 0]} | more


def written_json(folder, content):
    path = folder / "lenses.json"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("key", ["camera", "id", "name", "cam"])
def test_the_cameras_of_a_list_have_the_names_that_they_say(tmp_path, key):
    listed = [camera(100.0 * k, **{key: f"cam{k}"}) for k in (1, 2, 3)]
    found = read_lenses(written_json(tmp_path, listed))
    assert {name: lens["fl_x"] for name, lens in found.items()} == {
        "cam1": 100,
        "cam2": 200,
        "cam3": 300,
    }


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([camera(100.0), camera(200.0)], "camera 1 of the list must have a name"),
        (camera(dist=None, k1=-0.3, k4=0.1), "may be of OpenCV's fisheye"),
        (camera(dist=None, radial=[-0.3, 0.1]), "must be one list .* got radial"),
        (camera(size="1280x960"), "size"),
    ],
)
def test_what_would_be_left_out_is_refused(tmp_path, content, message):
    with pytest.raises(PrepareError, match=message):
        read_lenses(written_json(tmp_path, content))


@pytest.mark.parametrize(
    "content",
    [
        camera(size={"width": 640, "height": 480}),
        {"image_size": [640, 480], "cameras": {"cam0": camera()}},
        {"width": 640, "height": 480, "cameras": [camera()]},
    ],
)
def test_the_size_is_found_in_a_block_and_above_the_cameras(tmp_path, content):
    (lens,) = read_lenses(written_json(tmp_path, content)).values()
    assert (lens["w"], lens["h"]) == (640, 480)


def test_why_a_calibration_is_not_read_is_told(tmp_path):
    path = tmp_path / "stereo.json"
    path.write_text(json.dumps({"cam1": 3}))
    with pytest.raises(PrepareError, match="As a calibration it is not read either: "):
        read_lenses(path)


@pytest.mark.parametrize("key", ["k1", "dist", "image_size", "fisheye"])
def test_lists_of_unlike_lengths_are_no_traceback(tmp_path, key):
    path = tmp_path / "a.json"
    path.write_text(
        json.dumps({"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], key: [[1], [2, 3]]})
    )
    if key == "fisheye":
        assert read_lenses(path)["a"]["camera_model"] == "OPENCV"
        return
    with pytest.raises(PrepareError, match=rf"a.json.* {key}|{key} must be"):
        read_lenses(path)
