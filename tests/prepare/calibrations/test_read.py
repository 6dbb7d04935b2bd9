"""Calibrations of other programs: one rig in every format is one rig."""

import json
import re

import numpy as np
import pytest
from quads import arc
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.document import transform_matrix
from gaussray.prepare.errors import PrepareError


WIDTH, HEIGHT = 640, 480
MATRIX = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
DISTORTION = np.array([-0.05, 0.02, 0.001, -0.002])
POSES = arc(3)
NAMES = ("cam01", "cam02", "cam03")
# Numbers in files have this many digits at least.
CLOSE = 1e-6


def write_qualisys(folder):
    cameras = ""
    for name, pose in zip(NAMES, POSES, strict=True):
        # The file's axes are OpenCV's after half a turn about x.
        turn = np.diag([1, -1, -1]) @ pose[:, :3]
        place = -pose[:, :3].T @ pose[:, 3] * 1000
        numbers = [f'r{i + 1}{j + 1}="{turn[i, j]:.12f}"' for i in range(3) for j in range(3)]
        numbers += [f'{axis}="{x:.9f}"' for axis, x in zip("xyz", place, strict=True)]
        k = DISTORTION
        cameras += f"""<camera serial="{name}"><fov_video left="0" top="0" right="{WIDTH - 1}"
            bottom="{HEIGHT - 1}"/><transform {" ".join(numbers)}/>
            <intrinsic focalLengthU="{64 * MATRIX[0, 0]}" focalLengthV="{64 * MATRIX[1, 1]}"
            centerPointU="{64 * MATRIX[0, 2]}" centerPointV="{64 * MATRIX[1, 2]}"
            radialDistortion1="{k[0]}" radialDistortion2="{k[1]}"
            tangentalDistortion1="{k[2]}" tangentalDistortion2="{k[3]}"/></camera>"""
    path = folder / "rig.qca.txt"
    path.write_text(f"<calibration><cameras>{cameras}</cameras></calibration>")
    return path


def write_toml(folder):
    text = ""
    for name, pose in zip(NAMES, POSES, strict=True):
        vector = Rotation.from_matrix(pose[:, :3]).as_rotvec().tolist()
        text += f"""[{name}]\nname = "{name}"\nsize = [{WIDTH}.0, {HEIGHT}.0]
matrix = {MATRIX.tolist()}\ndistortions = {DISTORTION.tolist()}
rotation = {vector}\ntranslation = {pose[:, 3].tolist()}\nfisheye = false\n\n"""
    path = folder / "rig.toml"
    path.write_text(text + "[metadata]\nadjusted = false\nerror = 0.0\n")
    return path


def opencv_matrix(key, values):
    values = np.atleast_2d(values)
    data = ", ".join(repr(float(x)) for x in values.ravel())
    return (
        f"{key}: !!opencv-matrix\n  rows: {values.shape[0]}\n  cols: {values.shape[1]}\n"
        f"  dt: d\n  data: [ {data} ]\n"
    )


def write_easymocap(folder):
    names = "names:\n" + "".join(f'  - "{name}"\n' for name in NAMES)
    inner = outer = "%YAML:1.0\n---\n" + names
    for name, pose in zip(NAMES, POSES, strict=True):
        inner += opencv_matrix(f"K_{name}", MATRIX)
        inner += opencv_matrix(f"dist_{name}", np.append(DISTORTION, 0.0))
        vector = Rotation.from_matrix(pose[:, :3]).as_rotvec()
        outer += opencv_matrix(f"R_{name}", vector[:, None])
        outer += opencv_matrix(f"Rot_{name}", pose[:, :3])
        outer += opencv_matrix(f"T_{name}", pose[:, 3:])
    (folder / "intri.yml").write_text(inner)
    (folder / "extri.yml").write_text(outer)
    return folder


def write_kalibr(folder):
    text, before = "", np.eye(4)
    for k, pose in enumerate(POSES):
        matrix = np.vstack([pose, [0, 0, 0, 1]])
        text += f"cam{k}:\n  camera_model: pinhole\n  distortion_model: radtan\n"
        text += f"  distortion_coeffs: {DISTORTION.tolist()}\n"
        text += f"  intrinsics: {MATRIX[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()}\n"
        text += f"  resolution: [{WIDTH}, {HEIGHT}]\n  rostopic: /cam{k}/image\n"
        if k:
            text += f"  T_cn_cnm1: {(matrix @ np.linalg.inv(before)).tolist()}\n"
        before = matrix
    path = folder / "camchain.yaml"
    path.write_text(text)
    return path


def write_nerfstudio(folder):
    lens = {"camera_model": "OPENCV", "w": WIDTH, "h": HEIGHT}
    lens |= {"fl_x": MATRIX[0, 0], "fl_y": MATRIX[1, 1]}
    # Pixel centres at halves, as COLMAP has them.
    lens |= {"cx": MATRIX[0, 2] + 0.5, "cy": MATRIX[1, 2] + 0.5}
    lens |= dict(zip(("k1", "k2", "p1", "p2"), DISTORTION.tolist(), strict=True))
    frames = [
        {"file_path": f"images/{name}.png", "transform_matrix": transform_matrix(pose)}
        for name, pose in zip(NAMES, POSES, strict=True)
    ]
    path = folder / "transforms.json"
    path.write_text(json.dumps({**lens, "frames": frames}))
    return path


def panoptic(**changes):
    shared = {"type": "hd", "resolution": [WIDTH, HEIGHT], "K": MATRIX.tolist()}
    shared |= {"distCoef": [*DISTORTION.tolist(), 0.0]}
    return [
        {**shared, "name": name, "R": pose[:, :3].tolist(), "t": pose[:, 3:].tolist(), **changes}
        for name, pose in zip(("00_01", "00_02", "00_03"), POSES, strict=True)
    ]


def write_panoptic(folder):
    path = folder / "calibration_150821_dance.json"
    path.write_text(json.dumps({"calibDataSource": "x", "cameras": panoptic()}))
    return path


def write_metashape(folder):
    k1, k2, p1, p2 = DISTORTION
    size = f'<resolution width="{WIDTH}" height="{HEIGHT}"/>'
    text = f"""<sensors><sensor id="0" type="frame">{size}<calibration><f>{MATRIX[1, 1]}</f>
        <b1>{MATRIX[0, 0] - MATRIX[1, 1]}</b1><cx>{MATRIX[0, 2] + 0.5 - WIDTH / 2}</cx>
        <cy>{MATRIX[1, 2] + 0.5 - HEIGHT / 2}</cy><k1>{k1}</k1><k2>{k2}</k2><p1>{p2}</p1>
        <p2>{p1}</p2></calibration></sensor></sensors>"""
    for name, pose in zip(NAMES, POSES, strict=True):
        matrix = np.linalg.inv(np.vstack([pose, [0, 0, 0, 1]]))
        numbers = " ".join(map(str, matrix.ravel()))
        text += f'''<cameras><camera sensor_id="0" label="{name}.mp4">
            <transform>{numbers}</transform></camera></cameras>'''
    text = text.replace("</cameras><cameras>", "")
    path = folder / "rig.xml"
    path.write_text(f"<document><chunk>{text}</chunk></document>")
    return path


WRITERS = (
    *(write_qualisys, write_toml, write_easymocap, write_kalibr, write_nerfstudio),
    *(write_panoptic, write_metashape),
)


@pytest.mark.parametrize("write", WRITERS)
def test_every_format_gives_the_same_cameras(tmp_path, write):
    cameras = read_calibration(write(tmp_path)).cameras
    world = np.vstack([POSES[0], [0, 0, 0, 1]]) if write is write_kalibr else np.eye(4)
    assert len(cameras) == len(POSES)
    for camera, pose in zip(cameras, POSES, strict=True):
        # Kalibr's world is the first camera.
        assert camera.pose == pytest.approx((pose @ np.linalg.inv(world)), abs=CLOSE)
        lens = camera.lens
        assert (lens["fl_x"], lens["fl_y"]) == pytest.approx((500, 505), abs=CLOSE)
        assert (lens["cx"], lens["cy"]) == pytest.approx((310.75, 243.0), abs=CLOSE)
        found = [lens[key] for key in ("k1", "k2", "p1", "p2")]
        assert found == pytest.approx(DISTORTION, abs=CLOSE)
        size = (0, 0) if write is write_easymocap else (WIDTH, HEIGHT)
        assert (lens["w"], lens["h"]) == size


def test_cameras_of_the_panoptic_studio_are_called_as_its_videos(tmp_path):
    known = {one.name: one.pose for one in read_calibration(write_panoptic(tmp_path)).cameras}
    assert known["hd_00_02"] == pytest.approx(POSES[1], abs=CLOSE)
    (tmp_path / "a.json").write_text(json.dumps({"cameras": panoptic(type="other")}))
    names = [camera.name for camera in read_calibration(tmp_path / "a.json").cameras]
    assert names == ["00_01", "00_02", "00_03"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"R": [[1, 0], [0, 1]]}, "cameras[0]: R must be 9 numbers, got [[1, 0], [0, 1]]. It"),
        ({"t": ["x", 0, 0]}, "cameras[0]: t must be 3 numbers"),
        ({"resolution": None}, "cameras[0]: resolution must be 2 numbers"),
        ({"name": "a"}, "a name of its own, got hd_a twice"),
        ({"name": None}, "cameras[0].name must be a text"),
        ({"K": (-MATRIX).tolist()}, "must have positive focal lengths"),
    ],
)
def test_a_camera_of_the_panoptic_studio_needs_all_its_numbers(tmp_path, changes, message):
    (tmp_path / "a.json").write_text(json.dumps({"cameras": panoptic(**changes)}))
    with pytest.raises(ValueError, match=re.escape(message)):
        read_calibration(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.toml", "[x", "must be TOML"),
        ("a.toml", "[x", "[cam_0] or [cameras.0], with matrix (3 x 3), distortions, size"),
        (
            "a.toml",
            "[x]\ny = 1\n",
            "must have a table with a matrix for each camera, got [x]. Each",
        ),
        ("a.toml", "[cameras.0]\nsize = [2, 2]", "cam_0 has no matrix and no rotation and no"),
        ("a.yml", "%YAML:1.0\nK: !!opencv-matrix\n", "Write a file for each camera with Cam"),
        ("a.xml", "<?xml version='1.0'?><opencv_storage/>", "got no keys. Write a file for"),
        ("a.qca.txt", "<calibration/>", "must list cameras"),
        ("a.xml", "<!DOCTYPE x><x/>", "must not declare entities"),
        ("a.yaml", "a: [", "Give the file as its program has written it."),
        ("a.yaml", "[]", "as Kalibr does"),
        ("a.yaml", "cam0: {camera_model: omni}", "must be a pinhole"),
        (
            "a.yml",
            "camera_matrix:\n- [1.0, 0.0, 2.0]\ndist_coefs: [0.1]\n",
            "holds the lens of one camera (camera_matrix), and poses.calibration needs the lenses",
        ),
        (
            "a.yaml",
            "image_width: 2\ncamera_name: a\ncamera_matrix: {rows: 1, cols: 1, data: [1]}\n",
            "poses of all cameras. Give a file that has them, or leave it out and give poses.lens=",
        ),
        ("a.txt", "", "must be a calibration of a kind that is read, got .txt. Write its"),
        ("a.pkl", "", "Write its cameras to a .toml with a table for each, [cam_0]"),
        ("a.json", '{"a": 1}', "cameras, got a. Give each camera, under its name, finite numbers"),
        ("a.json", '{"a": {"b": 1}}', "must list frames (nerfstudio) or cameras, got a with b."),
        ("a.json", "[[]]", "must list frames (nerfstudio) or cameras, got nothing."),
        ("a.json", "3", "must list frames (nerfstudio) or cameras, got 3."),
        ("extri.yml", "a: 1", "intri.yml must be beside it"),
    ],
)
def test_what_is_no_calibration_is_named(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises((PrepareError, OSError), match=re.escape(message)):
        read_calibration(tmp_path / name)


def test_the_chessboard_of_opencv_beside_a_calibration_is_none(tmp_path):
    write_toml(tmp_path)
    board = '<?xml version="1.0"?>\n<opencv_storage>\n<rows>5</rows>\n</opencv_storage>\n'
    (tmp_path / "checkerboard.xml").write_text(board)
    assert [camera.name for camera in read_calibration(tmp_path).cameras] == list(NAMES)


def test_a_mirrored_rotation_is_refused(tmp_path):
    text = write_toml(tmp_path).read_text()
    path = tmp_path / "bad.toml"
    path.write_text(text.replace("500.0, 0", "-500.0, 0"))
    with pytest.raises(PrepareError, match="must have positive focal lengths"):
        read_calibration(path)
