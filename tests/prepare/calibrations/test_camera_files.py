"""OpenCV's files of one camera each, in a folder or each in a folder of its own."""

import json

import numpy as np
import pytest
from quads import arc
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


POSES = arc(3)
NAMES = ("cam1", "cam2", "cam3")
MATRIX = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
DISTORTION = np.array([[-0.05], [0.02], [0.001], [-0.002], [0.01]])
BOARD = {"CheckerBoardWidth": np.array([[8.0]])}


def voxel_carving(pose):
    """As scripts with a config.xml for each camera write it."""
    turn = Rotation.from_matrix(pose[:, :3]).as_rotvec()
    values = {"CameraMatrix": MATRIX, "DistortionCoeffs": DISTORTION}
    return values | {"RotationValues": turn[:, None], "TranslationValues": pose[:, 3:]}


def openpose(pose):
    """As OpenPose writes it: CameraMatrix is [R | t]."""
    values = {"CameraMatrix": pose, "Intrinsics": MATRIX, "Distortion": np.zeros((8, 1))}
    values["Distortion"][:5] = DISTORTION
    return values | {"CameraMatrixInitial": np.eye(3, 4)}


def as_xml(values):
    text = '<?xml version="1.0"?>\n<opencv_storage>\n'
    for key, value in values.items():
        data = " ".join(f"{x:.17g}" for x in np.ravel(value))
        text += f'<{key} type_id="opencv-matrix"><rows>{len(value)}</rows>'
        text += f"<cols>{value.shape[1]}</cols><dt>d</dt><data>{data}</data></{key}>\n"
    return text + "</opencv_storage>\n"


def as_yaml(values):
    text = "%YAML:1.0\n---\n"
    for key, value in values.items():
        data = ", ".join(f"{float(x)!r}" for x in np.ravel(value))
        text += f"{key}: !!opencv-matrix\n   rows: {len(value)}\n   cols: {value.shape[1]}\n"
        text += f"   dt: d\n   data: [ {data} ]\n"
    return text


def write(path, text):
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    return path


def check(calibration):
    assert [one.name for one in calibration.cameras] == list(NAMES)
    for one, pose in zip(calibration.cameras, POSES, strict=True):
        assert one.pose == pytest.approx(pose, abs=1e-9)
        assert (one.lens["fl_y"], one.lens["cx"]) == (505.0, 310.75)
        assert [one.lens[key] for key in ("k1", "p2", "k3")] == [-0.05, -0.002, 0.01]


@pytest.mark.parametrize("values", [voxel_carving, openpose])
@pytest.mark.parametrize(("suffix", "written"), [("xml", as_xml), ("yml", as_yaml)])
def test_files_are_called_as_the_cameras(tmp_path, capsys, values, suffix, written):
    for name, pose in zip(NAMES, POSES, strict=True):
        write(tmp_path / f"{name}.{suffix}", written(values(pose)))
    write(tmp_path / "checkerboard.xml", as_xml(BOARD))
    check(read_calibration(tmp_path))
    told = capsys.readouterr().out
    assert "cam1, cam2, cam3 are each read from their own file" in told
    assert "taken as OpenCV's, from world to camera" in told


@pytest.mark.parametrize("values", [voxel_carving, openpose])
def test_a_folder_may_have_a_folder_for_each_camera(tmp_path, values):
    write(tmp_path / "checkerboard.xml", as_xml(BOARD))
    (tmp_path / "empty").mkdir()
    for name, pose in zip(NAMES, POSES, strict=True):
        write(tmp_path / name / "config.xml", as_xml(values(pose)))
        write(tmp_path / name / "intrinsics.xml", as_xml({"CameraMatrix": MATRIX}))
        write(tmp_path / name / "boardcorners.xml", as_xml({"corners": np.zeros((88, 2))}))
    check(read_calibration(tmp_path))
    write(tmp_path / "cam2" / "copy.xml", as_xml(values(POSES[0])))
    with pytest.raises(PrepareError, match="inside must hold .* got config.xml, copy.xml in cam2"):
        read_calibration(tmp_path)


def test_a_json_file_may_lie_in_the_folder_of_its_camera(tmp_path):
    for name, pose in zip(NAMES, POSES, strict=True):
        values = {key: value.tolist() for key, value in openpose(pose).items()}
        write(tmp_path / name / "calibration.json", json.dumps(values))
    check(read_calibration(tmp_path))


def test_one_file_is_told_to_give_the_folder(tmp_path):
    path = write(tmp_path / "cam1" / "config.xml", as_xml(openpose(POSES[0])))
    message = f"got one. .* give their folder: poses.calibration={path.parent}. .* folder above"
    with pytest.raises(PrepareError, match=message):
        read_calibration(path)
    with pytest.raises(PrepareError, match="a file for each camera, .* got cam1/config.xml"):
        read_calibration(tmp_path)


def test_two_files_of_one_name_are_refused(tmp_path):
    write(tmp_path / "cam1.xml", as_xml(openpose(POSES[0])))
    write(tmp_path / "cam1.yml", as_yaml(openpose(POSES[1])))
    with pytest.raises(PrepareError, match="one file for each camera, got cam1.xml and cam1.yml"):
        read_calibration(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"Intrinsics": MATRIX * 1e300}, "camera cam2 must have finite numbers of at most"),
        ({"Intrinsics": MATRIX.T}, "matrix of camera cam2 must end with the row 0 0 1"),
        ({"CameraMatrix": MATRIX @ POSES[1]}, "camera cam2 must have positive focal lengths and a"),
        ({"CameraMatrix": -POSES[1]}, "camera cam2 must have determinant 1, got -1"),
        (
            {"Distortion": np.full((5, 1), np.nan)},
            "cam2: Distortion must be 1 or 2 or 4 or 5",
        ),
        ({"Distort": DISTORTION}, "Distort of camera cam2 is not read"),
    ],
)
def test_a_wrong_value_is_named(tmp_path, change, message):
    write(tmp_path / "cam1.xml", as_xml(openpose(POSES[0])))
    write(tmp_path / "cam2.xml", as_xml(openpose(POSES[1]) | change))
    with pytest.raises(PrepareError, match=message):
        read_calibration(tmp_path)


@pytest.mark.parametrize(
    "change", [{"Intrinsics": MATRIX * np.nan}, {"CameraMatrix": np.zeros((3, 3))}]
)
def test_a_file_without_a_pose_is_named_as_not_read(tmp_path, capsys, change):
    for name, pose in zip(NAMES[:2], POSES, strict=False):
        write(tmp_path / f"{name}.xml", as_xml(openpose(pose)))
    write(tmp_path / "cam3.xml", as_xml(openpose(POSES[2]) | change))
    assert len(read_calibration(tmp_path).cameras) == 2
    assert (
        "cam1, cam2 are each read from their own file, and cam3.xml is" in capsys.readouterr().out
    )


def test_a_size_in_the_file_is_read(tmp_path):
    sides = {"image_width": np.array([[640]]), "image_height": np.array([[480]])}
    for name, pose in zip(NAMES, POSES, strict=True):
        write(tmp_path / f"{name}.xml", as_xml(voxel_carving(pose) | sides))
    assert {one.lens["w"] for one in read_calibration(tmp_path).cameras} == {640}


def test_other_keys_are_told_the_keys_that_are_read(tmp_path):
    path = write(tmp_path / "a.xml", as_xml({"Foo": MATRIX}))
    with pytest.raises(PrepareError, match="got Foo. Write a file for each camera with") as error:
        read_calibration(path)
    assert len(str(error.value)) - len(str(path)) < 350


@pytest.mark.parametrize("values", [voxel_carving, openpose])
def test_the_lens_of_one_file_is_read_without_its_pose(tmp_path, values):
    path = write(tmp_path / "cam1.xml", as_xml(values(POSES[0])))
    lens = read_lenses(path)["cam1"]
    assert (lens["fl_x"], lens["cy"], lens["k1"]) == (500, 243, -0.05)


def test_files_of_something_else_in_the_folder_are_passed_over(tmp_path):
    for name, pose in zip(NAMES, POSES, strict=True):
        write(tmp_path / f"{name}.xml", as_xml(voxel_carving(pose)))
    write(tmp_path / "settings.json", json.dumps({"fx": 1000, "fy": 1000}))
    check(read_calibration(tmp_path))


def test_a_camera_file_whose_values_differ_is_told(tmp_path):
    matrix = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]
    one = {"K": matrix, "R": np.eye(3).tolist(), "t": [0, 0, 1]}
    write(tmp_path / "a.json", json.dumps(one))
    write(tmp_path / "b.json", json.dumps(one | {"fx": 5, "fy": 5, "cx": 320, "cy": 240}))
    with pytest.raises(PrepareError, match="b.json: fx, fy, cx and cy must not differ"):
        read_calibration(tmp_path)
