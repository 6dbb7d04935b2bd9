"""Calibrations in the words of their authors' documentation, with numbers that can be checked by
hand. Pixel centres of the files are at whole numbers, ours at 0.5."""

import re

import numpy as np
import pytest

from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


# A camera that looks along the world's x axis from (0.3, -0.2, -0.1), y down: z to x, x to -z.
POSE2SIM = """
[cam_01]
name = "cam_01"
size = [ 1920.0, 1080.0]
matrix = [ [ 1681.25, 0.0, 959.5], [ 0.0, 1680.5, 539.5], [ 0.0, 0.0, 1.0]]
distortions = [ -0.0455, 0.139, 0.0006, 0.0007]
rotation = [ 0.0, -1.5707963267948966, 0.0]
translation = [ -0.1, 0.2, -0.3]
fisheye = FISHEYE

[metadata]
adjusted = false
error = 0.0
"""


@pytest.mark.parametrize("fisheye", [False, True])
def test_pose2sim(tmp_path, fisheye):
    path = tmp_path / "Calib.toml"
    path.write_text(POSE2SIM.replace("FISHEYE", str(fisheye).lower()))
    (camera,) = read_calibration(path).cameras
    turn = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]
    assert camera.name == "cam_01" and camera.pose[:, :3] == pytest.approx(np.array(turn))
    assert -camera.pose[:, :3].T @ camera.pose[:, 3] == pytest.approx([0.3, -0.2, -0.1])
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2")
    assert [camera.lens[key] for key in names] == [-0.0455, 0.139, 0.0006, 0.0007]
    assert camera.lens["camera_model"] == ("OPENCV_FISHEYE" if fisheye else "OPENCV")
    assert (camera.lens["cx"], camera.lens["cy"]) == (960, 540)
    assert (camera.lens["w"], camera.lens["h"]) == (1920, 1080)


# Qualisys: millimetres, 64ths of a pixel; z up. It stands at (0, -5, 1) m and looks along y. Its
# own axes, the rows of the rotation, are right, up, back. (So they are for Pose2Sim, too.)
QUALISYS = """<?xml version='1.0' encoding='ASCII'?>
<calibration created="2024-05-03 10:00:00" qtm-version="2024.1" type="regular" wandLength="601.5">
  <results std-dev="0.5" min-max-diff="1.2"/>
  <cameras>
    <camera active="1" avg-residual="0.4" serial="21345" model="Miqus Video" viewrotation="0">
      <fov_marker left="0" top="0" right="1919" bottom="1079"/>
      <fov_video left="16" top="8" right="1295" bottom="727"/>
      <transform x="0.0" y="-5000.0" z="1000.0" r11="1" r12="0" r13="0" r21="0" r22="0" r23="1"
                 r31="0" r32="-1" r33="0"/>
      <intrinsic focallength="9.3" sensorMinU="0" sensorMaxU="122880" sensorMinV="0"
                 sensorMaxV="69120" focalLengthU="64000" focalLengthV="65280"
                 centerPointU="41952" centerPointV="23520" skew="0" radialDistortion1="-0.05"
                 radialDistortion2="0.14" radialDistortion3="0.02" tangentalDistortion1="0.0006"
                 tangentalDistortion2="0.0007"/>
    </camera>
  </cameras>
</calibration>
"""


def test_qualisys(tmp_path):
    path = tmp_path / "rig.qca.txt"
    path.write_text(QUALISYS)
    (camera,) = read_calibration(path).cameras
    assert camera.name == "21345"
    assert camera.pose == pytest.approx(np.array([[1, 0, 0, 0], [0, 0, -1, 1], [0, 1, 0, 5.0]]))
    lens = camera.lens
    assert (lens["fl_x"], lens["fl_y"]) == (1000, 1020)
    # The part of the sensor that the video shows begins at column 16 and row 8.
    assert (lens["cx"], lens["cy"]) == (655.5 - 16 + 0.5, 367.5 - 8 + 0.5)
    assert (lens["w"], lens["h"]) == (1280, 720)
    found = [lens[key] for key in ("k1", "k2", "p1", "p2", "k3")]
    assert found == [-0.05, 0.14, 0.0006, 0.0007, 0.02]


INTRINSICS = """%YAML:1.0
---
names:
  - "01"
  - "02"
K_01: !!opencv-matrix
  rows: 3
  cols: 3
  dt: d
  data: [1000., 0., 511.5, 0., 1001., 383.5, 0., 0., 1.]
dist_01: !!opencv-matrix
  rows: 1
  cols: 5
  dt: d
  data: [-1.0e-01, 2e-02, 0.001, -0.002, 0.]
K_02: !!opencv-matrix
  rows: 3
  cols: 3
  dt: d
  data: [900., 0., 500., 0., 900., 380., 0., 0., 1.]
dist_02: !!opencv-matrix
  rows: 1
  cols: 5
  dt: d
  data: [0., 0., 0., 0., 0.]
"""
EXTRINSICS = """%YAML:1.0
---
names:
  - "01"
  - "02"
R_01: !!opencv-matrix
  rows: 3
  cols: 1
  dt: d
  data: [0., 0., 0.]
Rot_01: !!opencv-matrix
  rows: 3
  cols: 3
  dt: d
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
T_01: !!opencv-matrix
  rows: 3
  cols: 1
  dt: d
  data: [0., 0., 3.]
R_02: !!opencv-matrix
  rows: 3
  cols: 1
  dt: d
  data: [1.5707963267948966, 0., 0.]
T_02: !!opencv-matrix
  rows: 3
  cols: 1
  dt: d
  data: [0.5, 0., 3.]
"""


def test_easymocap(tmp_path):
    (tmp_path / "intri.yml").write_text(INTRINSICS)
    (tmp_path / "extri.yml").write_text(EXTRINSICS)
    first, second = read_calibration(tmp_path).cameras
    assert (first.name, second.name) == ("01", "02")
    assert first.pose == pytest.approx(np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3.0]]))
    assert second.pose == pytest.approx(np.array([[1, 0, 0, 0.5], [0, 0, -1, 0], [0, 1, 0, 3.0]]))
    assert (first.lens["cx"], first.lens["cy"], first.lens["fl_y"]) == (512, 384, 1001)
    found = [first.lens[key] for key in ("k1", "k2", "p1", "p2")]
    assert found == [-0.1, 0.02, 0.001, -0.002]


# Pose2Sim's calib_toml_to_easymocap, of the camera of POSE2SIM and one more: it numbers the keys,
# whatever the names, appends a zero to the distortion, and OpenCV writes what follows.
NUMBERED_INTRINSICS = """%YAML:1.0
---
names:
   - cam_01
   - "7"
K_1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1681.25, 0., 9.5950000000000000e+02, 0., 1680.5, 539.5, 0., 0.,
       1. ]
dist_1: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -4.5499999999999999e-02, 0.13900000000000001,
       5.9999999999999995e-04, 6.9999999999999999e-04, 0. ]
K_2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 900., 0., 500., 0., 900., 380., 0., 0., 1. ]
dist_2: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
"""
NUMBERED_EXTRINSICS = """%YAML:1.0
---
names:
   - cam_01
   - "7"
R_1: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0., -1.5707963267948966, 0. ]
Rot_1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 2.2204460492503131e-16, 0., -1., 0., 1., 0., 1., 0.,
       2.2204460492503131e-16 ]
T_1: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -0.10000000000000001, 0.20000000000000001,
       -0.29999999999999999 ]
R_2: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0., 0., 0. ]
Rot_2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T_2: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0., 0., 3. ]
"""

# How OpenCV 5 begins a vector.
ND_MATRIX = r"opencv-nd-matrix\n   sizes: [ \1 ]"


@pytest.mark.parametrize("opencv", [4, 5])
@pytest.mark.parametrize("named", ["", "Intrinsic.yml", "Extrinsic.yml"])
def test_easymocap_files_of_pose2sim(tmp_path, named, opencv):
    """The pair gives the same camera as the TOML file that it was made of, but its size."""
    for name, text in (("Intrinsic", NUMBERED_INTRINSICS), ("Extrinsic", NUMBERED_EXTRINSICS)):
        if opencv == 5:
            text = text.replace("%YAML:1.0", "%YAML 1.2")
            text = re.sub(r"opencv-matrix\n   rows: (.)\n   cols: 1", ND_MATRIX, text)
            assert "nd-matrix" in text
        (tmp_path / f"{name}.yml").write_text(text)
    first, second = read_calibration(tmp_path / named).cameras
    path = tmp_path / "Calib.toml"
    path.write_text(POSE2SIM.replace("FISHEYE", "false"))
    (original,) = read_calibration(path).cameras
    assert (first.name, second.name) == ("cam_01", "7")
    assert first.pose == pytest.approx(original.pose)
    assert first.lens == original.lens | {"w": 0, "h": 0}
    assert (second.lens["fl_x"], second.pose[2, 3]) == (900, 3)
    with pytest.raises(PrepareError, match=r"got Calib.toml, Extrinsic.yml, Intrinsic.yml"):
        read_calibration(tmp_path)


# The second camera stands 0.11 to the right of the first, turned to the left by a right angle.
KALIBR = """
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.2769, 0.0671, 8.7538e-04, 1e-04]
  distortion_model: DISTORTION
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 1.0, 0.0, 0.0]
  - [-1.0, 0.0, 0.0, 0.11]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
  distortion_model: DISTORTION
  intrinsics: [460.0, 460.0, 375.5, 239.5]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
"""


@pytest.mark.parametrize(
    ("distortion", "model", "keys"),
    [
        ("radtan", "OPENCV", ("k1", "k2", "p1", "p2")),
        ("equidistant", "OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
    ],
)
def test_kalibr(tmp_path, distortion, model, keys):
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR.replace("DISTORTION", distortion))
    first, second = read_calibration(path).cameras
    assert first.lens["camera_model"] == model
    assert [first.lens[key] for key in keys] == [-0.2769, 0.0671, 8.7538e-04, 1e-04]
    assert (first.lens["fl_x"], first.lens["cy"]) == (461.629, 246.549)
    assert first.pose == pytest.approx(np.eye(4)[:3])
    assert -second.pose[:, :3].T @ second.pose[:, 3] == pytest.approx([0.11, 0, 0])
    # What it looks along, in the first camera's axes.
    assert second.pose[2, :3] == pytest.approx([-1, 0, 0])


# Axes right, up, back: the camera looks along -z from (1, 2, 3).
NERFSTUDIO = """{
  "camera_model": "OPENCV_FISHEYE",
  "fl_x": 1072.0, "fl_y": 1068.0, "cx": 1504.0, "cy": 1000.0, "w": 3008, "h": 2000,
  "k1": 0.0312, "k2": 0.0051, "k3": 0.0006, "k4": -0.0001,
  "frames": [
    {
      "file_path": "images/frame_00001.jpeg",
      "transform_matrix": [
        [1.0, 0.0, 0.0, 1.0],
        [0.0, 1.0, 0.0, 2.0],
        [0.0, 0.0, 1.0, 3.0],
        [0.0, 0.0, 0.0, 1.0]
      ]
    }
  ]
}"""


def test_nerfstudio(tmp_path):
    path = tmp_path / "transforms.json"
    path.write_text(NERFSTUDIO)
    (camera,) = read_calibration(path).cameras
    pose = [[1, 0, 0, -1], [0, -1, 0, 2], [0, 0, -1, 3.0]]
    assert camera.name == "frame_00001" and camera.pose == pytest.approx(np.array(pose))
    assert camera.lens["camera_model"] == "OPENCV_FISHEYE"
    found = [camera.lens[key] for key in ("k1", "k2", "k3", "k4", "cx", "cy")]
    assert found == [0.0312, 0.0051, 0.0006, -0.0001, 1504, 1000]
