"""Captures of 7-Scenes: a picture and a text with its pose for each frame of a moving camera."""

import numpy as np
import pytest
from known_photograph import PIXELS, PLACE, TURN, H, W, pixels, seen_points, write_picture

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.sevenscenes import read_sevenscenes
from gaussray.capture.open import format_of, open_capture


K = np.array([[50.0, 0, 31.5], [0, 52.0, 23.5], [0, 0, 1]])
POSE = np.vstack([np.column_stack([TURN, PLACE]), [0, 0, 0, 1]])


def write_matrix(path, matrix):
    path.write_text("\n".join(" ".join(f"{x:.17g}" for x in row) for row in matrix) + "\n")


def write_pose(folder, number, pose):
    write_matrix(folder / f"frame-{number:06d}.pose.txt", pose)


@pytest.fixture
def folder(tmp_path):
    home = tmp_path / "seq-01"
    for number in range(4):
        write_picture(home / f"frame-{number:06d}.color.png")
        write_pose(home, number, POSE if number == 1 else np.eye(4))
    write_picture(home / "frame-000000.depth.png")
    write_matrix(home / "camera-intrinsics.txt", K)
    return home


def check_pixels(view):
    world, own = seen_points()
    # The middle of the first pixel is 0 in the file, and 0.5 here.
    expected = (own @ K.T)[:, :2] / own[:, 2:] + 0.5
    np.testing.assert_allclose(pixels(view, world), expected, atol=PIXELS)


def test_pixels_and_times_are_those_of_the_frames(folder):
    assert format_of(folder) == "sevenscenes"
    capture = open_capture(folder)
    assert [view.time for view in capture.views] == [0, 0.25, 0.5, 0.75]
    assert {(view.camera_name, view.split) for view in capture.views} == {("sevenscenes", "train")}
    check_pixels(capture.views[1])


def test_pictures_without_a_valid_pose_are_left_out_with_one_warning(folder):
    write_pose(folder, 0, np.full((4, 4), -np.inf))
    write_pose(folder, 2, np.zeros((4, 4)))
    (folder / "frame-000003.pose.txt").write_text("-1.#IND 0 0 0\n" * 4)
    with pytest.warns(CaptureWarning) as told:
        (view,) = open_capture(folder).views
    assert len(told) == 1 and view.time == 0.25
    assert "3 of 4 pictures, first frame-000000.color.png, have no valid" in str(told[0].message)
    (folder / "frame-000001.pose.txt").unlink()
    with pytest.raises(CaptureError, match="at least one picture must have a pose.* none of 4"):
        open_capture(folder)


def test_the_lens_may_lie_in_the_folder_around_it_or_in_the_file_of_bundlefusion(folder):
    write_matrix(folder.parent / "camera-intrinsics.txt", K)
    (folder / "camera-intrinsics.txt").unlink()
    check_pixels(open_capture(folder).views[1])
    (folder.parent / "camera-intrinsics.txt").unlink()
    matrix = np.eye(4)
    matrix[:3, :3] = K
    numbers = " ".join(map(str, matrix.ravel()))
    info = f"m_colorWidth = {W}\nm_colorHeight = {H}\nm_calibrationColorIntrinsic = {numbers} \n"
    (folder / "info.txt").write_text(info)
    check_pixels(open_capture(folder).views[1])
    (folder / "info.txt").write_text("m_colorWidth = 3\n")
    with pytest.raises(CaptureError, match=r"info\.txt: must hold m_colorWidth, .*-intrinsics\.tx"):
        open_capture(folder)


def test_keys_of_a_lens_may_have_a_file(folder):
    (folder / "camera-intrinsics.txt").unlink()
    (folder / "camera.json").write_text('{"fl_x": 50, "fl_y": 52, "cx": 32, "cy": 24}')
    check_pixels(open_capture(folder).views[1])


def test_without_a_lens_the_file_to_write_is_named(folder):
    (folder / "camera-intrinsics.txt").unlink()
    with pytest.raises(
        CaptureError, match=r"no file tells the lens .* Write \S+seq-01/camera-intr"
    ):
        open_capture(folder)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("frame-000001.pose.txt", "1 2 3", "must hold a matrix, 4 lines of 4 numbers, got 3 words"),
        ("frame-000001.pose.txt", "a b c d\n" * 4, "must hold a matrix, 4 lines of 4 numbers"),
        ("frame-000001.pose.txt", "2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1", ".*without scale.*Divide"),
        ("frame-000001.pose.txt", "1 0 0 0\n0 1 0 0\n0 0 -1 0\n0 0 0 1", ".*without reflection"),
        ("frame-000001.pose.txt", "1 0 0 1e35\n0 1 0 0\n0 0 1 0\n0 0 0 1", ".*from the origin"),
        ("camera-intrinsics.txt", "1 0 3\n0 1", "must hold a matrix, 3 lines of 3 numbers"),
        ("camera-intrinsics.txt", "-1 0 3\n0 1 2\n0 0 1", r"the matrix must be \[fx 0 cx; 0 fy cy"),
        (
            "camera-intrinsics.txt",
            "1 0 nan\n0 1 2\n0 0 1",
            r"the matrix must be \[fx 0 cx; 0 fy cy",
        ),
        ("camera-intrinsics.txt", "\xff\xfe", "must hold a matrix"),
    ],
)
def test_what_is_no_matrix_is_named(folder, name, text, says):
    (folder / name).write_text(text, encoding="latin-1")
    with pytest.raises(CaptureError, match=f"{name}.*: {says}"):
        open_capture(folder)


def test_a_pointer_of_git_lfs_is_told(folder):
    (folder / "frame-000001.pose.txt").write_text("version https://git-lfs.github.com/spec/v1\n")
    with pytest.raises(OSError, match="frame-000001.pose.txt: is a pointer of Git LFS"):
        open_capture(folder)


def test_other_folders_are_none_of_it(folder, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"holds no frame-\*\.pose\.txt"):
        read_sevenscenes(tmp_path)
    for path in folder.glob("*.color.png"):
        path.unlink()
    says = "frame-000000.pose.txt is a pose .* It needs the picture frame-000000.color.png"
    for place in (folder, tmp_path):
        with pytest.raises(CaptureError, match=f"is no capture of a known format: .*{says}"):
            open_capture(place)
