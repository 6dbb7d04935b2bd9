"""Text files of lenses and poses, a pair for each camera."""

import numpy as np
import pytest
from quads import arc

from gaussray.prepare.calibrations.camera_dat import camera_dats
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


POSES = arc(3)
MATRIX = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
DISTORTION = (-0.05, 0.02, 0.001, -0.002, 0.01)
LONG, SHORT = (
    ("camera{}_intrinsics.dat", "camera{}_rot_trans.dat"),
    ("c{}.dat", "rot_trans_c{}.dat"),
)


def rows(values):
    return "".join(" ".join(map(str, row)) + " \n" for row in np.atleast_2d(values).tolist())


def write(folder, names=LONG, poses=POSES, prefix=""):
    for k, pose in enumerate(poses):
        lens = f"intrinsic:\n{rows(MATRIX)}distortion:\n{rows(np.array(DISTORTION))}"
        (folder / names[0].format(k)).write_text(lens)
        text = f"R:\n{rows(pose[:, :3])}T:\n{rows(pose[:, 3:])}"
        (folder / (prefix + names[1].format(k))).write_text(text)


@pytest.mark.parametrize(("names", "called"), [(LONG, "camera{}"), (SHORT, "c{}")])
def test_all_cameras_are_read_by_folder_or_file(tmp_path, names, called):
    write(tmp_path, names)
    (tmp_path / "kpts_cam0.dat").write_text("1 2 3\n")
    for place in (tmp_path, tmp_path / names[0].format(1), tmp_path / names[1].format(2)):
        calibration = read_calibration(place)
        assert not calibration.is_pair and not calibration.left_out
        assert [one.name for one in calibration.cameras] == [called.format(k) for k in range(3)]
        for one, pose in zip(calibration.cameras, POSES, strict=True):
            assert np.array_equal(one.pose, pose)
            assert (one.lens["fl_y"], one.lens["cx"], one.lens["k3"]) == (505, 310.75, 0.01)
            assert (one.lens["p2"], one.lens["w"], one.lens["h"]) == (-0.002, 0, 0)


def test_cameras_are_in_the_order_of_their_numbers(tmp_path):
    write(tmp_path, SHORT, arc(11))
    names = [one.name for one in read_calibration(tmp_path).cameras]
    assert names == [f"c{k}" for k in range(11)]


def test_poses_of_the_world_are_read_if_given_or_alone(tmp_path):
    write(tmp_path, prefix="world_to_")
    assert np.array_equal(read_calibration(tmp_path).cameras[1].pose, POSES[1])
    moved = [np.column_stack([pose[:, :3], pose[:, 3] + 1]) for pose in POSES]
    write(tmp_path, poses=moved)
    assert np.array_equal(read_calibration(tmp_path).cameras[1].pose, moved[1])
    given = tmp_path / "world_to_camera0_rot_trans.dat"
    assert np.array_equal(read_calibration(given).cameras[1].pose, POSES[1])


def test_after_a_remark_the_first_section_of_a_name_counts(tmp_path):
    write(tmp_path, SHORT)
    path = tmp_path / "rot_trans_c1.dat"
    other = f"R:\n{rows(np.eye(3))}T:\n{rows(np.full((3, 1), 9.0))}"
    text = path.read_text()
    path.write_text(f"{text}\n#below is from camera 0 to camera 1\n{other}")
    assert np.array_equal(read_calibration(tmp_path).cameras[1].pose, POSES[1])
    # Without a remark nothing tells which of them counts.
    path.write_text(text + other)
    with pytest.raises(PrepareError, match="rot_trans_c1.dat: R: must be 9 finite numbers, got 18"):
        read_calibration(tmp_path)


def test_a_camera_without_pose_is_left_out_and_one_alone_refused(tmp_path):
    write(tmp_path)
    (tmp_path / "camera2_rot_trans.dat").unlink()
    calibration = read_calibration(tmp_path)
    assert calibration.left_out == {"camera2": "has no file of R and T"}
    assert [one.name for one in calibration.cameras] == ["camera0", "camera1"]
    (tmp_path / "camera1_rot_trans.dat").unlink()
    with pytest.raises(PrepareError, match="two cameras or more, got camera0_intrinsics.dat, cam"):
        read_calibration(tmp_path)


def test_two_layouts_in_a_folder_are_two_calibrations(tmp_path):
    write(tmp_path)
    write(tmp_path, SHORT)
    assert [path.name for path in camera_dats(tmp_path)] == ["camera0_intrinsics.dat", "c0.dat"]
    with pytest.raises(PrepareError, match="one calibration, got c0.dat, camera0_intrinsics.dat"):
        read_calibration(tmp_path)
    assert len(read_calibration(tmp_path / "c0.dat").cameras) == 3


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("c1.dat", "intrinsic:\n1 0 0\n", "c1.dat: intrinsic: must be 9 finite numbers, got 3"),
        ("c1.dat", "", "c1.dat: intrinsic: is missing, got nothing. Each camera needs"),
        ("c1.dat", f"intrinsic:\n{rows(MATRIX)}", "c1.dat: distortion: is missing, got intrinsic"),
        ("c1.dat", f"intrinsic:\n{rows(MATRIX)}distortion:\n1\n", "c1.dat: distortion: must be 4"),
        ("c1.dat", "intrinsic:\n1 x 0\n", "c1.dat: line 2 must be numbers, got '1 x 0'. Each"),
        ("rot_trans_c1.dat", "R:\n1 0 0\n0 1 0\n", "rot_trans_c1.dat: R: must be 9 finite .* 6"),
        ("rot_trans_c1.dat", f"R:\n{rows(np.eye(3))}", "rot_trans_c1.dat: T: is missing, got r"),
        ("rot_trans_c1.dat", f"R:\n{rows(np.eye(3))}T:\nnan\n1\n2\n", "T: must be 3 finite .*nan"),
        ("rot_trans_c1.dat", f"R:\n{rows(-np.eye(3))}T:\n0\n1\n2\n", "R: .* without a reflection"),
        ("rot_trans_c1.dat", f"R:\n{rows(2 * np.eye(3))}T:\n0\n1\n2\n", "R: must be a rotation"),
    ],
)
def test_a_wrong_value_is_named(tmp_path, name, text, message):
    write(tmp_path, SHORT)
    (tmp_path / name).write_text(text)
    with pytest.raises(PrepareError, match=message):
        read_calibration(tmp_path)


def test_another_dat_file_is_told_the_names(tmp_path):
    (tmp_path / "points.dat").write_text("1 2 3")
    with pytest.raises(PrepareError, match="points.dat: .* camera0_intrinsics.dat and camera0_rot"):
        read_calibration(tmp_path / "points.dat")
