"""What readers of structure-from-motion projects share."""

from pathlib import Path

import numpy as np
import pytest
from known_photograph import PLACE, TURN, H, W, write_picture

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.sfm_project import Photograph, project_capture, rotation_in


LENS = {"camera_model": "PINHOLE", "w": W, "h": H, "fl_x": 50, "fl_y": 50, "cx": 32, "cy": 24}


def capture_of(folder, *paths):
    photographs = [Photograph(path, LENS, TURN, PLACE.tolist()) for path in paths]
    return project_capture(folder, Keys(folder / "project", {}), photographs, None, np.float32)


def test_cameras_of_equal_names_are_told_apart_by_their_folders(tmp_path):
    names = ("left/1.png", "right/1.png", "left/2.png")
    for name in names:
        write_picture(tmp_path / name)
    found = [view.camera_name for view in capture_of(tmp_path, *names).views]
    assert found == ["left_1", "right_1", "left_2"]
    write_picture(tmp_path / "left/1.exr")
    found = [view.camera_name for view in capture_of(tmp_path, "left/1.png", "left/1.exr").views]
    assert found == ["1.png", "1.exr"]


def test_pictures_without_poses_end_in_the_command_that_finds_them(tmp_path):
    folder = tmp_path / "my capture"
    write_picture(folder / "images/a.png")
    with pytest.raises(CaptureError) as caught:
        project_capture(folder, Keys(folder / "project", {}), [None], None, np.float32)
    command = f"`gaussray prepare 'videos={folder}/images' out=CAPTURE`."
    assert str(caught.value).endswith(command)
    (folder / "images/a.png").unlink()
    with pytest.raises(CaptureError, match=f"videos={folder}' out=CAPTURE"):
        project_capture(folder, Keys(folder / "project", {}), [], None, np.float32)


@pytest.mark.parametrize(
    "path",
    ["images\\a.png", "./images/a.png", "../images/a.png", "C:\\images\\a.png", "/images/a.png"],
)
def test_paths_of_any_system_lead_into_the_folder(tmp_path, path):
    write_picture(tmp_path / "images/a.png")
    (view,) = capture_of(tmp_path, path).views
    assert view.image == tmp_path / "images/a.png"


def test_pictures_that_were_converted_are_found(tmp_path):
    write_picture(tmp_path / "images/a.png")
    with pytest.warns(CaptureWarning, match="spelt otherwise"):
        (view,) = capture_of(tmp_path, "images/A.JPG").views
    assert view.image == tmp_path / "images/a.png"


def test_a_picture_must_not_lead_out_of_the_folder(tmp_path):
    write_picture(tmp_path / "a.png")
    (tmp_path / "in").mkdir()
    (tmp_path / "in/a.png").symlink_to(tmp_path / "a.png")
    with pytest.raises(CaptureError, match="must name a file in"):
        capture_of(tmp_path / "in", "a.png")


def test_a_rotation_is_right_handed_and_of_unit_vectors():
    keys = Keys(Path("file"), {"r": 0})
    np.testing.assert_array_equal(rotation_in(keys, "r", TURN.ravel().tolist()), TURN)
    for wrong in (-TURN, 1.01 * TURN, np.zeros((3, 3)), TURN[::-1], 1e200 * TURN):
        with pytest.raises(CaptureError, match="file: r must be a rotation: three unit vectors"):
            rotation_in(keys, "r", wrong.ravel().tolist())
