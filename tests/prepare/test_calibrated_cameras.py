"""A calibration needs the videos of two cameras."""

import numpy as np
import pytest

from gaussray.prepare.calibrated_cameras import check_calibrated_cameras
from gaussray.prepare.calibrations.known_camera import Calibration, KnownCamera
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


def source(name, tmp_path):
    return Source(name, tmp_path / f"{name}.mp4", (), np.arange(3.0), ((4, 3),))


def calibration(*names):
    return Calibration([KnownCamera(name, {"w": 4, "h": 3}, np.eye(4)[:3]) for name in names])


def test_a_single_camera_is_refused_with_those_that_have_no_video(tmp_path):
    with pytest.raises(PrepareError, match="got cam0_test alone: .* have none: c1, c2.") as told:
        check_calibrated_cameras(calibration("c0", "c1", "c2"), [source("cam0_test", tmp_path)])
    assert "leave poses.calibration out" in str(told.value)
    with pytest.raises(PrepareError, match="got c0 alone: (?!.*Add the videos)"):
        check_calibrated_cameras(calibration("c0"), [source("c0", tmp_path)])


def test_what_the_file_lacks_of_another_camera_is_told(tmp_path):
    known = calibration("c0")
    known.left_out["c1"] = "c1 has no rotation and no translation"
    with pytest.raises(PrepareError, match="c1 does not count, because c1 has no rotation and no"):
        check_calibrated_cameras(known, [source("c0", tmp_path)])


def test_two_cameras_are_enough(tmp_path):
    both = [source(name, tmp_path) for name in ("c0", "c1")]
    check_calibrated_cameras(calibration("c0", "c1", "c2"), both)
