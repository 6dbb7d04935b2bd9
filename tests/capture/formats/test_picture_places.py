"""Pictures are found where they are, if all paths of a file begin with another folder."""

import json
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.open import open_capture


POSE = np.eye(4).tolist()


def folder_of(tmp_path, listed, stored):
    """A capture whose file lists some paths, with pictures at others."""
    given = {"transform_matrix": POSE, "time": 0.0, "split": "train"}
    frames = [{"file_path": name, "camera": f"c{k}", **given} for k, name in enumerate(listed)]
    intrinsics = {"fl_x": 20.0, "fl_y": 20.0, "cx": 8.0, "cy": 6.0}
    (tmp_path / "transforms.json").write_text(json.dumps({**intrinsics, "frames": frames}))
    for k, name in enumerate(stored):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.full((12, 16, 3), 10 * k, np.uint8)).save(tmp_path / name)
    return tmp_path


@pytest.mark.parametrize(
    ("listed", "stored", "change"),
    [
        ("data/phone/images/{}.png", "images/{}.png", "its beginning data/phone/ is left out"),
        ("/home/one/in/images/{}.png", "images/{}.png", "its beginning home/one/in/ is left out"),
        ("C:\\users\\one\\{}.png", "pictures/{}.png", "begins with pictures/ instead of users/one"),
        ("../raw/{}", "images/{}.png", "it begins with images/ instead of raw/"),
        ("{}.png", "colmap/images/{}.png", "colmap/images/ is put before it"),
    ],
)
def test_one_folder_at_the_beginning_of_all_paths_is_changed(tmp_path, listed, stored, change):
    names = [f"{k:04d}" for k in range(4)]
    folder = folder_of(tmp_path, map(listed.format, names), map(stored.format, names))
    with pytest.warns(CaptureWarning, match=f"4 of 4 are found if .*{change}"):
        capture = open_capture(folder)
    assert [view.image for view in capture.views] == [tmp_path / stored.format(n) for n in names]
    assert capture.views[0].width == 16


def test_of_several_places_the_one_that_keeps_most_of_the_path_counts(tmp_path):
    stored = ["train/a.png", "train/b.png", "small/a.png", "small/b.png"]
    folder = folder_of(tmp_path, ["old/train/a.png", "old/train/b.png"], stored)
    with pytest.warns(CaptureWarning, match="old/ is left out"):
        capture = open_capture(folder)
    assert capture.views[1].image == tmp_path / "train/b.png"


def test_where_several_places_are_as_good_nothing_is_changed(tmp_path):
    folder = folder_of(tmp_path, ["a.png"], ["images/a.png", "images_2/a.png"])
    with pytest.raises(
        FileNotFoundError, match="must name a picture.*A file of this name is .*a.png"
    ):
        open_capture(folder)


def test_pictures_of_one_split_are_not_taken_for_those_of_another(tmp_path):
    folder = folder_of(tmp_path, ["test/a.png"], ["train/a.png"])
    with pytest.raises(FileNotFoundError, match="must name a picture"):
        open_capture(folder)


def test_where_one_picture_is_where_the_file_says_others_are_just_missing(tmp_path):
    folder = folder_of(tmp_path, ["in/a.png", "in/b.png"], ["in/a.png", "b.png"])
    with pytest.warns(CaptureWarning) as told:
        capture = open_capture(folder)
    assert [view.image.name for view in capture.views] == ["a.png"]
    assert "1 of 2 frames have no picture" in str(told[0].message)


@pytest.mark.parametrize(
    ("listed", "stored"),
    [
        ("images/{}.jpg", "rgb/{}.jpg"),
        ("/home/x/images/{}", "rgb/{}.jpg"),
        ("in/cam/{}.png", "out/cam/{}.png"),
    ],
)
def test_a_few_pictures_are_found_where_nothing_else_is(tmp_path, listed, stored):
    there = ["7", "8"]
    folder = folder_of(tmp_path, map(listed.format, range(9)), map(stored.format, there))
    with pytest.warns(CaptureWarning) as told:
        capture = open_capture(folder)
    assert [view.image for view in capture.views] == [tmp_path / stored.format(n) for n in there]
    assert any("2 of 9 are found if it begins with" in str(one.message) for one in told)


def test_that_one_of_many_absent_pictures_lies_elsewhere_is_told(tmp_path):
    intrinsics = {"w": 16, "h": 12}
    stored = ["rgb/7.png", "rgb/other.png"]
    folder = folder_of(tmp_path, [f"images/{k}.png" for k in range(9)], stored)
    content = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps({**intrinsics, **content}))
    with pytest.raises(CaptureError, match=r"9 of 9 frames .*A file of this name is .*7\.png"):
        open_capture(folder)


def test_masks_move_with_their_pictures(tmp_path):
    folder = folder_of(tmp_path, ["x/images/a.png"], ["images/a.png", "masks/a.png"])
    content = json.loads((folder / "transforms.json").read_text())
    content["frames"][0]["mask_path"] = "x/masks/a.png"
    (folder / "transforms.json").write_text(json.dumps(content))
    with pytest.warns(CaptureWarning, match="x/ is left out"):
        capture = open_capture(folder)
    assert capture.views[0].mask == tmp_path / "masks/a.png"


def test_the_lists_of_splits_move_with_their_pictures(tmp_path):
    folder = folder_of(tmp_path, ["x/a.png", "x/b.png"], ["images/a.png", "images/b.png"])
    content = json.loads((folder / "transforms.json").read_text())
    for frame in content["frames"]:
        del frame["split"]
    content |= {"train_filenames": ["x/a.png"], "test_filenames": ["x/b.png"]}
    (folder / "transforms.json").write_text(json.dumps(content))
    with pytest.warns(CaptureWarning, match="it begins with images/ instead of x/"):
        capture = open_capture(folder)
    assert [view.split for view in capture.views] == ["train", "test"]


def test_a_file_beside_that_has_another_name_is_not_taken(tmp_path):
    stored = ["out/0.png", "out/1.png", "out/other.png"]
    folder = folder_of(tmp_path, [f"in/{k}.png" for k in range(7)], stored)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(FileNotFoundError, match="must name a picture"):
            open_capture(folder)
    assert Path(folder / "out/0.png").is_file()


@pytest.mark.parametrize(
    ("listed", "stored"),
    [
        ("images/{}.jpg", "images/{}.JPG"),
        ("images/{}.png", "images/{}.jpg"),
        ("A{}.PNG", "a{}.png"),
    ],
)
def test_pictures_of_another_letter_case_or_suffix_are_found(tmp_path, listed, stored):
    names = [f"{k}.0" for k in range(4)]
    folder = folder_of(tmp_path, map(listed.format, names), map(stored.format, names))
    with pytest.warns(CaptureWarning, match="4 of 4 are found if their names are spelt otherwise"):
        capture = open_capture(folder)
    assert [view.image for view in capture.views] == [tmp_path / stored.format(n) for n in names]


def test_pictures_that_were_moved_and_converted_are_found(tmp_path):
    listed = ["/home/x/images/a.jpeg", "/home/x/images/b.jpeg"]
    folder = folder_of(tmp_path, listed, ["images/a.png", "images/b.png"])
    with pytest.warns(CaptureWarning, match="2 of 2 are found if its beginning home/x/ is left"):
        capture = open_capture(folder)
    assert [view.image for view in capture.views] == [tmp_path / f"images/{n}.png" for n in "ab"]


def test_of_two_pictures_that_are_spelt_alike_none_is_taken(tmp_path):
    stored = ["a.PNG", "a.jpg"]
    with pytest.raises(FileNotFoundError, match="A.tif.: neither it nor another"):
        open_capture(folder_of(tmp_path, ["A.tif", "1.png"], stored))


def test_undistorted_pictures_of_another_model_are_not_taken(tmp_path):
    folder = folder_of(tmp_path, ["images/0.png"], ["dense/images/0.png"])
    (tmp_path / "dense" / "sparse").mkdir()
    home = re.escape(str(tmp_path / "dense"))
    with pytest.raises(FileNotFoundError, match=f"a model of its own: name {home}, and do not"):
        open_capture(folder)
