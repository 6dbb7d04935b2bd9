"""Which files and folders of an input may be of cameras."""

import warnings

import pytest

from gaussray.capture.errors import CaptureWarning
from gaussray.prepare.input_files import (
    MEDIA_SUFFIXES,
    camera_folders,
    files_in,
    photographs_in,
    unread_files,
)


def touch(folder, *names):
    """Empty files below a folder."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def names(paths):
    return [path.name for path in paths]


def test_files_are_in_natural_order_whatever_the_case_of_their_suffix(tmp_path):
    touch(tmp_path, "cam10.MP4", "cam9.mp4", ".cam1.mp4", "notes.txt", "folder.mp4/inside")
    assert names(files_in(tmp_path, MEDIA_SUFFIXES)) == ["cam9.mp4", "cam10.MP4"]


def test_raw_files_beside_their_pictures_are_not_missed(tmp_path):
    touch(tmp_path, "a.dng", "a.jpg", "b.DNG", "c.insv", "d.txt")
    assert names(unread_files(tmp_path)) == ["b.DNG", "c.insv"]


def test_folders_of_masks_and_calibrations_are_no_cameras_and_are_named(tmp_path):
    touch(tmp_path, "cam2/a.jpg", "cam10/a.jpg", "masks/a.png", "calib/a.png", "empty/notes.txt")
    with pytest.warns(CaptureWarning, match="calib, masks: by the name no pictures of a camera"):
        found = camera_folders(tmp_path, alone=True)
    assert names(found) == ["cam2", "cam10", "empty"]


def test_folders_of_masks_are_cameras_where_nothing_else_could_be_one(tmp_path):
    touch(tmp_path, "masks/a.png", "depth/a.png")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert names(camera_folders(tmp_path, alone=True)) == ["depth", "masks"]
    with pytest.warns(CaptureWarning, match="depth, masks"):
        assert camera_folders(tmp_path, alone=False) == []


def test_depth_maps_beside_photographs_are_left_out_and_counted(tmp_path):
    touch(tmp_path, *(f"{k}{word}" for k in range(4) for word in (".color.jpg", ".depth.png")))
    text = r"4 of 8 files \(0.depth.png, 1.depth.png, 2.depth.png \.\.\.\)"
    with pytest.warns(CaptureWarning, match=text):
        assert names(photographs_in(tmp_path)) == [f"{k}.color.jpg" for k in range(4)]
    for path in tmp_path.glob("*.color.jpg"):
        path.unlink()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert names(photographs_in(tmp_path)) == [f"{k}.depth.png" for k in range(4)]
