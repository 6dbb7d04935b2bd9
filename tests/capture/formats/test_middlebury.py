"""Captures of Middlebury's multi-view stereo: a line of numbers for each picture."""

import codecs
import time

import numpy as np
import pytest
from known_photograph import PIXELS, SHIFT, TO_CAMERA, pixels, seen_points, write_picture

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.middlebury import middlebury_file, read_middlebury
from gaussray.capture.open import format_of, open_capture


K = np.array([[50.0, 0, 33.5], [0, 52.0, 22], [0, 0, 1]])


def line(name, k=K, rotation=TO_CAMERA, shift=SHIFT):
    numbers = np.concatenate([np.ravel(k), np.ravel(rotation), shift])
    return " ".join([name, *(f"{x:.17g}" for x in numbers)])


def lay(folder, lines, count=None, name="temple_par.txt"):
    text = "\n".join([str(len(lines) if count is None else count), *lines])
    (folder / name).write_text(text + "\n\n")
    return folder


@pytest.fixture
def folder(tmp_path):
    for name in ("a0001.png", "a0002.png"):
        write_picture(tmp_path / name)
    (tmp_path / "temple_ang.txt").write_text("1.0 2.0 a0001.png\n")
    return lay(
        tmp_path, [line("a0001.png"), line("a0002.png", rotation=np.eye(3), shift=(1, 2, 3))]
    )


def test_pixels_are_those_of_the_projections(folder):
    assert format_of(folder) == "middlebury"
    capture = open_capture(folder)
    assert [(view.camera_name, view.split) for view in capture.views] == [
        ("a0001", "train"),
        ("a0002", "train"),
    ]
    world, own = seen_points()
    # The middle of the first pixel is 0 in the file, and 0.5 here.
    expected = (own @ K.T)[:, :2] / own[:, 2:] + 0.5
    np.testing.assert_allclose(pixels(capture.views[0], world), expected, atol=PIXELS)
    own = world + (1, 2, 3)
    expected = (own @ K.T)[:, :2] / own[:, 2:] + 0.5
    np.testing.assert_allclose(pixels(capture.views[1], world), expected, atol=PIXELS)


def test_pictures_may_be_absent_or_in_a_folder(folder):
    (folder / "a0001.png").unlink()
    with pytest.warns(CaptureWarning, match="1 of 2 frames have no picture"):
        assert [view.camera_name for view in open_capture(folder).views] == ["a0002"]
    (folder / "images").mkdir()
    (folder / "a0002.png").rename(folder / "images/a0002.png")
    write_picture(folder / "images/a0001.png")
    with pytest.warns(CaptureWarning, match="images/ is put before it"):
        assert len(open_capture(folder).views) == 2


def test_another_number_of_lines_and_another_file_are_told(folder):
    lay(folder, [line("a0001.png")], count=7)
    lay(folder, [line("a0002.png")], name="zebra_par.txt")
    with pytest.warns(CaptureWarning) as told:
        (view,) = open_capture(folder).views
    assert view.camera_name == "a0001"
    texts = [str(one.message) for one in told]
    assert any("says 7 pictures, but 1 follow" in text for text in texts)
    assert any("zebra_par.txt is not read" in text for text in texts)


@pytest.mark.parametrize("name", ["a0001.png", "./a0001.png"])
def test_a_picture_listed_twice_is_refused(folder, name):
    lay(folder, [line("a0001.png"), line(name)])
    says = "temple_par.txt: each view must have a picture of its own, got a0001.png 2 times"
    with pytest.raises(CaptureError, match=says):
        open_capture(folder)


def test_pictures_that_differ_in_their_type_have_cameras_of_their_own(folder):
    lay(folder, [line("a0001.png"), line("a0001.exr", shift=(1, 2, 3))])
    write_picture(folder / "a0001.exr")
    names = [view.camera_name for view in open_capture(folder).views]
    assert names == ["a0001.png", "a0001.exr"]


def test_a_byte_order_mark_and_other_line_ends_are_read(folder):
    text = (folder / "temple_par.txt").read_bytes().replace(b"\n", b"\r\n")
    (folder / "temple_par.txt").write_bytes(codecs.BOM_UTF8 + b"\r\n" + text)
    assert format_of(folder) == "middlebury"
    assert len(open_capture(folder).views) == 2


def test_blanks_take_no_time(folder):
    (folder / "temple_par.txt").write_text("1\n" + "x" + " " * 90_000 + "y\n")
    start = time.perf_counter()
    assert middlebury_file(folder) is None
    # The blanks squared would take a minute.
    assert time.perf_counter() - start < 5


@pytest.mark.parametrize(
    ("second", "says"),
    [
        ("a0002.png 1 2 3", "must be a picture's name and 21 finite numbers"),
        ("a0002.png " + "x " * 21, "must be a picture's name and 21 finite numbers"),
        (line("a0002.png", shift=(np.nan, 0, 0)), "must be a picture's name and 21 finite"),
        (line("a0002.png", k=K + np.eye(3, k=1)), r"must be one whose K is \[fx 0 cx; 0 fy"),
        (line("a0002.png", k=K * [-1, 1, 1]), ".* with fx and fy above 0"),
        (line("a0002.png", rotation=2 * TO_CAMERA), "must be a rotation"),
        (line("a0002.png", rotation=-TO_CAMERA), "must be a rotation"),
    ],
)
def test_what_is_no_camera_is_named(folder, second, says):
    lay(folder, [line("a0001.png"), second])
    with pytest.raises(CaptureError, match=f"temple_par.txt, picture 1: line {says}"):
        open_capture(folder)


def test_other_files_of_this_name_are_no_cameras(folder):
    numbers = "1 " * 21
    for text in ("parameters: 3\nno camera\n", "1\n", "", "1\n" + numbers, f"-1\na.png {numbers}"):
        (folder / "temple_par.txt").write_text(text)
        with pytest.raises(CaptureError, match="must hold the files of one format|is no capture"):
            open_capture(folder)
    with pytest.raises(FileNotFoundError, match="holds no "):
        read_middlebury(folder)
