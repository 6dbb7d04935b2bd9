"""Calibrations as Caliscope writes them: camera_array.toml, and tables at the top level before."""

import pathlib

import numpy as np
import pytest
from quads import arc
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.assign import assign_cameras
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


POSES = np.array(arc(3))
MATRIX = [[900.0, 0.0, 640.0], [0.0, 905.0, 360.0], [0.0, 0.0, 1.0]]
CLOSE = 1e-9


def table(pose, **changed):
    """The keys of one camera; what is None is not written."""
    values = {
        **{"port": 0, "size": [1280, 720], "rotation_count": 0, "error": 0.4, "grid_count": 20},
        **{"matrix": MATRIX, "distortions": [-0.1, 0.02, 0.001, -0.002, 0.003]},
        **{"translation": pose[:, 3].tolist(), "rotation": pose[:, :3].tolist()},
        **{"ignore": False, "verified_resolutions": [[640, 480], [1280, 720]]},
    }
    values |= changed
    lines = [f"{key} = {value!r}" for key, value in values.items() if value is not None]
    return "\n".join(lines).replace("True", "true").replace("False", "false") + "\n\n"


def write(folder, tables, heading="cameras.{}"):
    path = folder / "camera_array.toml"
    named = enumerate(tables)
    path.write_text("".join(f"[{heading.format(k)}]\n{text}" for k, text in named))
    return path


def source(name):
    return Source(name, pathlib.Path(f"{name}.mp4"), (), np.zeros(3), ((1280, 720),))


@pytest.mark.parametrize("heading", ["cameras.{}", "cam_{}"])
@pytest.mark.parametrize("vector", [False, True])
@pytest.mark.parametrize("video", ["cam_{}", "port_{}"])
def test_a_rig_is_read_in_every_layout(tmp_path, heading, vector, video):
    turns = Rotation.from_matrix(POSES[:, :, :3])
    written = turns.as_rotvec().tolist() if vector else turns.as_matrix().tolist()
    tables = [table(pose, rotation=w) for pose, w in zip(POSES, written, strict=True)]
    board = "[charuco]\ncolumns = 4\n\n[stereo_0_1]\nrotation = [0.0, 0.0, 0.0]\n"
    path = write(tmp_path, [*tables[:2], tables[2] + board], heading)
    calibration = read_calibration(path)
    assert [camera.name for camera in calibration.cameras] == ["cam_0", "cam_1", "cam_2"]
    assert not calibration.left_out
    given, findings, _ = assign_cameras(calibration, [source(video.format(k)) for k in (2, 0)])
    assert not findings
    for k in (2, 0):
        camera = given[video.format(k)]
        assert camera.pose == pytest.approx(POSES[k], abs=CLOSE)
        assert (camera.lens["fl_y"], camera.lens["cx"], camera.lens["w"]) == (905, 640.5, 1280)
        assert (camera.lens["k2"], camera.lens["p2"], camera.lens["k3"]) == (0.02, -0.002, 0.003)


def test_the_folder_of_a_session_has_other_files_beside(tmp_path):
    write(tmp_path, [table(pose) for pose in POSES])
    for name in ("charuco.toml", "project_settings.toml"):
        (tmp_path / name).write_text("columns = 4\n")
    assert len(read_calibration(tmp_path).cameras) == 3


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"ignore": True}, "is marked ignore"),
        ({"rotation": "null", "translation": "null"}, "has no rotation and no translation"),
        ({"rotation": None, "translation": None}, "has no rotation and no translation"),
        ({"translation": []}, "has no translation"),
        ({"matrix": None}, "has no matrix"),
    ],
)
def test_a_camera_that_is_not_calibrated_is_left_out_with_its_video(tmp_path, changed, reason):
    path = write(tmp_path, [table(POSES[0]), table(POSES[1], **changed), table(POSES[2])])
    calibration = read_calibration(path)
    assert [camera.name for camera in calibration.cameras] == ["cam_0", "cam_2"]
    assert calibration.left_out == {"cam_1": reason}
    given, findings, _ = assign_cameras(calibration, [source(f"cam_{k}") for k in range(3)])
    assert list(given) == ["cam_0", "cam_2"]
    (finding,) = findings
    assert (finding.level, finding.subject) == ("warn", "cameras")
    assert f"cam_1: left out, because cam_1 {reason}" in finding.text
    with pytest.raises(PrepareError, match=f"got cam_1 {reason}. Calibrate these cameras"):
        assign_cameras(calibration, [source("cam_1")])


def test_a_file_without_any_pose_names_the_missing_step(tmp_path):
    tables = [table(pose, rotation=None, translation=None) for pose in POSES]
    with pytest.raises(PrepareError, match=r"cam_2 has no rotation .* Finish the calibration"):
        read_calibration(write(tmp_path, tables))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"rotation": [0.0, 1.0]}, "rotation of 3 or 9 numbers, got"),
        ({"matrix": [900.0, 905.0]}, "matrix of 9 numbers, got"),
        ({"translation": "far"}, "translation of 3 numbers, got far"),
        ({"size": [1280]}, "size of 2 numbers, got"),
        ({"distortions": "wide"}, "distortions of numbers, got wide"),
    ],
)
def test_a_wrong_value_is_named_with_what_a_table_needs(tmp_path, changed, message):
    path = write(tmp_path, [table(POSES[0], **changed)])
    with pytest.raises(PrepareError, match=rf"cam_0 must have {message}.* Each camera needs a"):
        read_calibration(path)


def test_two_tables_of_one_name_are_refused(tmp_path):
    tables = [table(pose, name="front") for pose in POSES[:2]]
    with pytest.raises(PrepareError, match="a name of its own, got front twice. Change"):
        read_calibration(write(tmp_path, tables, "cam_{}"))
