"""Which video is of the first camera of a stereo calibration."""

import pathlib

import numpy as np
import pytest

from gaussray.prepare.calibrations.assign import assign_cameras, stills_by_camera
from gaussray.prepare.calibrations.pair_names import check_pair, named_pair, names_in_order
from gaussray.prepare.calibrations.stereo_pair import stereo_cameras
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


MATRIX = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
VALUES = {"K1": MATRIX, "K2": MATRIX, "D1": np.zeros(5), "D2": np.zeros(5)}
PAIR = stereo_cameras("a", {**VALUES, "R": np.eye(3), "T": np.array([-1.0, 0, 0])})


def source(name):
    return Source(name, pathlib.Path(f"{name}.mp4"), (), np.zeros(3), ((640, 480),))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("left", "right"),
        ("extracted_frames_left_cam", "extracted_frames_right_cam"),
        ("Left", "RIGHT"),
        ("leftcam", "rightcam"),
        ("imgL", "imgR"),
        ("LCam", "RCam"),
        ("bright_left", "bright_right"),
        ("cam_l", "cam_r"),
        ("camA", "camB"),
        ("cam0", "cam1"),
        ("1", "2"),
        ("view_01", "view_02"),
        ("left_2", "right_1"),
    ],
)
def test_names_that_say_it(first, second):
    assert names_in_order([first, second]) == names_in_order([second, first]) == (first, second)
    for videos in ([first, second], [second, first]):
        given, findings, _ = assign_cameras(PAIR, [source(name) for name in videos])
        assert given[first].pose[0, 3] == 0 and given[second].pose[0, 3] == -1 and not findings
        # The file has no size: it is the video's.
        assert (given[first].lens["w"], given[second].lens["h"]) == (640, 480)


@pytest.mark.parametrize(
    "names",
    [
        ("video_down", "video_upper"),
        ("front", "left"),
        ("bright", "left"),
        ("cam3", "cam7"),
        ("cam1", "cam1b"),
        ("side", "side_2"),
    ],
)
def test_names_that_do_not_say_it(names):
    assert names_in_order(names) is None
    with pytest.raises(PrepareError, match=f"say which is which .* got {names[0]}, {names[1]}. Re"):
        assign_cameras(PAIR, [source(name) for name in names])


def test_more_videos_than_cameras_are_refused_and_one_is_given_by_its_side():
    with pytest.raises(PrepareError, match="of two cameras, got 3 videos .*: left, right, front"):
        assign_cameras(PAIR, [source(name) for name in ("left", "right", "front")])
    given, _, _ = assign_cameras(PAIR, [source("right")])
    assert given["right"].pose[0, 3] == -1


def test_the_match_is_told(capsys):
    assign_cameras(PAIR, [source("cam1"), source("cam0")])
    told = capsys.readouterr().out
    assert "cam0 is its first (left) camera, and cam1 its second (right) one." in told


def test_two_stills_of_one_folder_are_of_both_cameras():
    paths = tuple(pathlib.Path("rig") / f"cam{k}.png" for k in (2, 1))
    folder = Source("rig", pathlib.Path("rig"), paths, np.zeros(0), ((640, 480),) * 2)
    found = stills_by_camera(PAIR, [folder])
    assert [one.name for one in found] == ["cam2", "cam1"]
    given, _, _ = assign_cameras(PAIR, found)
    assert given["cam1"].pose[0, 3] == 0 and given["cam2"].pose[0, 3] == -1


def test_a_calibration_with_names_stays():
    named = type(PAIR)(PAIR.cameras)
    assert named_pair(named, ["cam0", "cam1"]) is named
    check_pair(named, ["x", "y", "z"])
    assert [one.name for one in named_pair(PAIR, ["b", "a"]).cameras] == ["a", "b"]
