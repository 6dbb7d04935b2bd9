"""Calibrations of other programs: one rig in every format is one rig."""

import dataclasses
import json
import pathlib
import re

import numpy as np
import pytest
from quads import arc
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.assign import assign_cameras, stills_by_camera
from gaussray.prepare.calibrations.known_camera import Calibration, KnownCamera
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.document import transform_matrix
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


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


def source(name, width=WIDTH, height=HEIGHT):
    return Source(name, pathlib.Path(f"{name}.mp4"), (), np.zeros(3), ((width, height),))


def test_cameras_are_given_by_name_or_by_number(tmp_path):
    known = read_calibration(write_toml(tmp_path))
    given, remarks = assign_cameras(known, [source("Cam02"), source("view_1")])
    assert given["Cam02"].pose == pytest.approx(POSES[1], abs=CLOSE)
    assert given["view_1"].pose == pytest.approx(POSES[0], abs=CLOSE) and not remarks
    with pytest.raises(PrepareError, match="got no left among cam01, cam02, cam03"):
        assign_cameras(known, [source("left")])


def test_a_camera_may_be_a_part_of_the_name_of_its_video(tmp_path):
    text = write_toml(tmp_path).read_text()
    for old, new in (("cam01", "back"), ("cam02", "top"), ("cam03", "side")):
        text = text.replace(old, new)
    (tmp_path / "c.toml").write_text(text)
    known = read_calibration(tmp_path / "c.toml")
    given, _ = assign_cameras(known, [source("minimal_Top"), source("minimal-back")])
    assert given["minimal_Top"].pose == pytest.approx(POSES[1], abs=CLOSE)
    with pytest.raises(PrepareError, match="got no stop"):
        assign_cameras(known, [source("stop")])


def test_cameras_of_the_panoptic_studio_are_called_as_its_videos(tmp_path):
    known = read_calibration(write_panoptic(tmp_path))
    given, _ = assign_cameras(known, [source("hd_00_02")])
    assert given["hd_00_02"].pose == pytest.approx(POSES[1], abs=CLOSE)
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


def test_another_size_is_scaled_and_another_shape_refused(tmp_path):
    known = read_calibration(write_toml(tmp_path))
    given, remarks = assign_cameras(known, [source("cam01", 320, 240)])
    assert given["cam01"].lens["fl_x"] == pytest.approx(250) and "it is scaled" in remarks[0].text
    given, remarks = assign_cameras(known, [source("cam01", 640, 488)])
    assert given["cam01"].lens["fl_y"] == pytest.approx(505) and "as it is" in remarks[0].text
    with pytest.raises(PrepareError, match="of the same shape"):
        assign_cameras(known, [source("cam01", 480, 640)])


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


def test_two_cameras_of_one_pose_are_refused(tmp_path):
    cameras = read_calibration(write_toml(tmp_path)).cameras
    copied = KnownCamera("cam03", cameras[2].lens, cameras[1].pose)
    calibration = Calibration([*cameras[:2], copied])
    with pytest.raises(PrepareError, match=r"for cam02 and cam03, .* Calibrate the poses"):
        assign_cameras(calibration, [source(name) for name in NAMES])
    # Two photographs may be from one place, unless nobody has calibrated it, or all are from it.
    photographs = stills_by_camera(calibration, stills(*NAMES))
    _, findings = assign_cameras(calibration, photographs)
    (text,) = (one.text for one in findings if one.subject == "cameras")
    assert text.startswith("cam02 and cam03 have the same pose") and "not matched" in text
    nowhere = [KnownCamera(c.name, c.lens, np.eye(3, 4)) for c in cameras[1:]]
    alike = [dataclasses.replace(camera, pose=cameras[0].pose) for camera in cameras]
    for given in ([cameras[0], *nowhere], alike):
        with pytest.raises(PrepareError, match="as if they had not been calibrated"):
            assign_cameras(Calibration(given), photographs)
    # Neither the same place alone nor the same rotation alone is a copy.
    turned, moved = cameras[1].pose.copy(), cameras[1].pose.copy()
    turn = Rotation.from_rotvec([0, 1e-3, 0]).as_matrix()
    turned, moved[:, 3] = turn @ turned, moved[:, 3] + [0.001, 0, 0]
    for pose in (turned, moved):
        calibration = Calibration([*cameras[:2], KnownCamera("cam03", cameras[2].lens, pose)])
        given, _ = assign_cameras(calibration, [source(name) for name in NAMES])
        assert list(given) == list(NAMES)


def test_two_videos_of_one_camera_are_refused(tmp_path):
    known = read_calibration(write_toml(tmp_path))
    with pytest.raises(PrepareError, match="got cam01 for both view_1 and cam_1"):
        assign_cameras(known, [source("view_1"), source("cam_1")])


def stills(*names):
    """Pictures of one folder."""
    paths = tuple(pathlib.Path("rig") / f"{name}.jpg" for name in names)
    sizes = ((WIDTH, HEIGHT),) * len(names)
    return [Source("rig", pathlib.Path("rig"), paths, np.zeros(0), sizes)]


def test_a_picture_of_each_camera_in_one_folder_is_that_camera(tmp_path, capsys):
    known = read_calibration(write_toml(tmp_path))
    found = stills_by_camera(known, stills(*NAMES))
    assert [(one.name, one.count) for one in found] == [(name, 1) for name in NAMES]
    assert [one.pictures[0].name for one in found] == [f"{name}.jpg" for name in NAMES]
    given, _ = assign_cameras(known, found)
    assert list(given) == list(NAMES)
    assert "each of the 3 pictures is of the camera of its name." in capsys.readouterr().out
    # The camera may be a part of the name; one without a pose is told of by `assign_cameras`.
    found = stills_by_camera(known, stills("cam_1_img_0", "cam_2_img_0"))
    assert [one.name for one in found] == ["cam_1", "cam_2"]


@pytest.mark.parametrize("names", [("cam01",), ("cam01", "view_1"), ("a_1", "b_9")])
def test_other_pictures_of_one_folder_stay_together(tmp_path, names):
    known, sources = read_calibration(write_toml(tmp_path)), stills(*names)
    assert stills_by_camera(known, sources) == sources
    with pytest.raises(PrepareError, match="put each picture into a folder of its own name"):
        assign_cameras(known, sources)
    both = [source("cam01"), source("left")]
    assert stills_by_camera(known, both) == both
    with pytest.raises(PrepareError, match="Rename the video or folder, or take it away"):
        assign_cameras(known, both)
