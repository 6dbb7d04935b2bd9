"""Captures of KITTI's odometry: rectified cameras side by side, with a line for each pose."""

import re
import warnings

import numpy as np
import pytest
from known_photograph import PIXELS, PLACE, TURN, pixels, seen_points, write_picture

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.kitti import kitti_near_miss, read_kitti
from gaussray.capture.open import format_of, open_capture
from gaussray.prepare.calibrations.lens_file import read_lenses


K = np.array([[50.0, 0, 31.5], [0, 52.0, 23.5], [0, 0, 1]])
POSES = [np.eye(3, 4), np.column_stack([TURN, PLACE]), np.column_stack([TURN, PLACE + 1])]
# To the right of camera 0.
BASELINE = 0.54


def words(matrix):
    return " ".join(f"{x:.17g}" for x in np.ravel(matrix))


def projection(shift):
    """That of a rectified camera at a place of the first camera's axes."""
    return np.column_stack([K, -K @ shift])


def lay(folder, left="image_2", right="image_3", labels=("P0: ", "P1: ", "P2: ", "P3: ")):
    for name in (left, right):
        for number in range(len(POSES)):
            write_picture(folder / name / f"{number:06d}.png")
    (folder / "poses.txt").write_text("\n".join(map(words, POSES)) + "\n")
    rows = [projection((i % 2 * BASELINE, 0, 0)) for i in range(len(labels))]
    text = "\n".join(label + words(row) for label, row in zip(labels, rows, strict=True))
    (folder / "calib.txt").write_text(f"{text}\nTr: 1 2 3\n")
    return folder


def check_pixels(view, shift):
    world, own = seen_points()
    projected = (own - (shift, 0, 0)) @ K.T
    # The middle of the first pixel is 0 in the file, and 0.5 here.
    expected = projected[:, :2] / projected[:, 2:] + 0.5
    np.testing.assert_allclose(pixels(view, world), expected, atol=PIXELS)


@pytest.mark.parametrize(
    ("left", "right", "labels"),
    [
        ("image_2", "image_3", ("P0: ", "P1: ", "P2: ", "P3: ")),
        ("image_0", "image_1", ("P0: ", "P1: ")),
        ("image_l", "image_r", ("", "")),
    ],
)
def test_pixels_and_times_are_those_of_both_cameras(tmp_path, left, right, labels):
    assert format_of(lay(tmp_path, left, right, labels)) == "kitti"
    capture = open_capture(tmp_path)
    assert capture.time_unit == "normalised"
    names = [(view.camera_name, round(3 * view.time), view.split) for view in capture.views]
    assert names == [(name, k, "train") for name in (left, right) for k in range(3)]
    check_pixels(capture.views[1], 0)
    check_pixels(capture.views[4], BASELINE)


def test_poses_and_times_may_be_those_of_the_numbers(tmp_path):
    folder = lay(tmp_path / "sequences/07")
    (tmp_path / "poses").mkdir()
    (folder / "poses.txt").rename(tmp_path / "poses/07.txt")
    (folder / "times.txt").write_text("0\n0.1\n0.25\n")
    for name in ("image_2", "image_3"):
        (folder / name / "000000.png").unlink()
    write_picture(folder / "image_2/000009.png")
    write_picture(folder / "image_0/000001.png")
    assert format_of(folder) == "kitti"
    with pytest.warns(CaptureWarning, match="image_2, image_3 is read, and image_0 is not"):
        capture = open_capture(folder)
    # Of three pictures the poses are in order, whatever their numbers.
    assert [v.time for v in capture.views] == [0, 0.1, 0.25, 0.1, 0.25]
    (folder / "image_0/000001.png").unlink()
    (folder / "image_0").rmdir()
    write_picture(folder / "image_2/000010.png")
    with pytest.warns(CaptureWarning, match="2 of 6 pictures, first image_2/000009.png, have no"):
        capture = open_capture(folder)
    assert [v.time for v in capture.views] == [0.1, 0.25, 0.1, 0.25]
    assert capture.time_unit == "seconds"


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("calib.txt", "P0: 1 2 3", "line 1: it must be twelve finite numbers"),
        ("calib.txt", "nothing: 1", "must have the projection P2: ..., got none"),
        ("calib.txt", "", "must have the projection P2: ..., got none"),
        ("calib.txt", "P2: " + "0 " * 12, r"line 1: P2.* must be \[fx 0 cx; 0 fy cy; 0 0 1\]"),
        ("calib.txt", "P2: " + "nan " * 12, "line 1: it must be twelve finite numbers"),
        ("poses.txt", f"{words(POSES[0])}\n1 2 3", "line 2: it must be twelve numbers"),
        (
            "poses.txt",
            "\n".join([words(POSES[0]), words(2 * POSES[1]), words(POSES[2])]),
            "poses.txt, line 2: pose must be a rigid",
        ),
        ("poses.txt", words(np.zeros(12)), "at least one picture must have a pose"),
        ("times.txt", "0\n1", "must hold a time for each of the 3 poses, got 2. Remove it"),
        ("times.txt", "0\n1\nnan", "line 3: it must be a finite time"),
        ("times.txt", "0\n2\n1", "image_2/000002.png: time must be later than 2"),
        ("times.txt", "0\n2\nx", "line 3: it must be a time in seconds"),
    ],
)
def test_what_contradicts_the_format_is_named(tmp_path, name, text, says):
    lay(tmp_path)
    (tmp_path / name).write_text(text)
    with pytest.raises(CaptureError, match=says):
        open_capture(tmp_path)


def test_without_a_calibration_the_file_is_named(tmp_path):
    (lay(tmp_path) / "calib.txt").unlink()
    with pytest.raises(
        FileNotFoundError, match=r"calib\.txt: no such file\. It must have the proj"
    ):
        open_capture(tmp_path)


@pytest.mark.parametrize(
    ("folder", "poses", "labels"),
    [
        ("images", "poses.txt", ("P0: ", "P1: ")),
        ("images", "ground_truth.txt", ("", "")),
        ("left", "frames.txt", ("P2: ",)),
    ],
)
def test_pictures_of_one_camera_may_be_in_another_folder(tmp_path, folder, poses, labels):
    lay(tmp_path, folder, "depth", labels)
    (tmp_path / "poses.txt").rename(tmp_path / poses)
    (tmp_path / "notes.txt").write_text("1 2 3\n")
    assert format_of(tmp_path) == "kitti"
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        capture = open_capture(tmp_path)
    texts = [str(one.message) for one in told if "projection" in str(one.message)]
    assert len(texts) == (len(labels) > 1)
    assert all(f"{folder} is taken as the pictures of P0, the first proj" in text for text in texts)
    assert [view.camera_name for view in capture.views] == 3 * [folder]
    check_pixels(capture.views[1], 0)


@pytest.mark.parametrize(
    ("moves", "says"),
    [
        (
            {"calib.txt": "lens.txt", "image_2": "images", "image_3": "depth"},
            "poses.txt has twelve .* It needs calib.txt with projections",
        ),
        (
            {"image_2": "a", "image_3": "b"},
            "poses.txt .* It needs pictures in image_2/, image_0/, image_l/ or images/",
        ),
        ({"calib.txt": "lens.txt", "image_2": "a", "image_3": "b"}, "poses.txt .* pictures in"),
        (
            {"poses.txt": "a.txt", "times.txt": "b.txt"},
            "a.txt has twelve .* It needs one file of poses, to be called poses.txt",
        ),
    ],
)
def test_what_a_folder_with_poses_lacks_is_told(tmp_path, moves, says):
    folder = lay(tmp_path / "capture")
    (folder / "times.txt").write_text((folder / "poses.txt").read_text())
    for old, new in moves.items():
        (folder / old).rename(folder / new)
    (folder / "times.txt").unlink(missing_ok=True)
    with pytest.raises(CaptureError, match=rf"known format: {says}.*gaussray prepare"):
        open_capture(folder)
    with pytest.raises(FileNotFoundError, match=f"{folder}: {says}"):
        read_kitti(folder)


POSES_TOLD = "poses.txt has twelve numbers a line, as poses of KITTI have. It needs "


@pytest.mark.parametrize(
    ("calibration", "pictures", "needs"),
    [
        (None, "images", "calib.txt with projections (P0: and twelve numbers)."),
        (None, "left", "calib.txt with projections (P0: and twelve numbers)."),
        ("500 500 8 6", "images", "calib.txt with projections (P0: and twelve numbers)."),
        ("P0: 1 2 3", "images", "calib.txt with projections (P0: and twelve numbers)."),
        (words(K @ POSES[0]), None, "pictures in image_2/, image_0/, image_l/ or images/."),
        (
            None,
            None,
            "calib.txt with projections (P0: and twelve numbers) and pictures in image_2/, "
            "image_0/, image_l/ or images/.",
        ),
    ],
)
def test_only_what_is_not_there_is_asked_for(tmp_path, calibration, pictures, needs):
    (tmp_path / "poses.txt").write_text("\n".join(map(words, POSES)))
    if calibration is not None:
        (tmp_path / "calib.txt").write_text(calibration)
    if pictures is not None:
        write_picture(tmp_path / pictures / "000000.png")
    assert kitti_near_miss(tmp_path) == POSES_TOLD + needs
    with pytest.raises(CaptureError, match=re.escape(f"known format: {POSES_TOLD}{needs} Or")):
        open_capture(tmp_path)


@pytest.mark.parametrize("labels", [("P0: ", "P1: "), ("P_rect_00: ", "P_rect_01: ")])
@pytest.mark.parametrize("left", ["image_0", "images"])
def test_without_poses_the_command_that_finds_them_is_given(tmp_path, left, labels):
    lay(tmp_path, left, left, labels)
    (tmp_path / "poses.txt").unlink()
    command = (
        f"gaussray prepare videos={tmp_path / left} poses.lens={tmp_path / 'calib.txt'} "
        "frames.rate=10 out=OUT"
    )
    with pytest.raises(CaptureError) as caught:
        open_capture(tmp_path)
    told = str(caught.value)
    assert "the poses are missing" in told and command in told and "of no format" not in told
    # The lenses of the projections are read, and are one; `Tr:` is none.
    lenses = read_lenses(tmp_path / "calib.txt")
    assert list(lenses) == ["P0", "P1"] and lenses["P0"] == lenses["P1"]
    assert lenses["P0"]["fl_x"] == pytest.approx(K[0, 0])
    assert lenses["P0"]["cx"] == pytest.approx(K[0, 2] + 0.5)


@pytest.mark.parametrize("calibration", ["500 500 8 6", "P0: 1 2 3", "fx: 500"])
def test_a_calibration_without_projections_is_none_of_kitti(tmp_path, calibration):
    lay(tmp_path)
    (tmp_path / "poses.txt").unlink()
    (tmp_path / "calib.txt").write_text(calibration)
    with pytest.raises(CaptureError, match="is no capture of a known format") as caught:
        open_capture(tmp_path)
    assert "poses are missing" not in str(caught.value)


@pytest.mark.parametrize("values", ["0 " * 12, "nan " * 12])
def test_a_projection_that_is_none_is_named_in_another_folder_too(tmp_path, values):
    lay(tmp_path, "images", "depth")
    (tmp_path / "calib.txt").write_text(f"P0: {values}")
    with pytest.raises(CaptureError, match=r"calib\.txt, line 1: "):
        open_capture(tmp_path)


def test_other_folders_are_none_of_it(tmp_path):
    lay(tmp_path)
    (tmp_path / "poses.txt").write_text("1 2 3 4 5 6 7 8\n")
    with pytest.raises(CaptureError, match="is no capture of a known format"):
        open_capture(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"holds no poses\.txt with twelve numbers a line"):
        read_kitti(tmp_path)
