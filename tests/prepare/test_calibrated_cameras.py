"""A calibration needs the videos of two cameras."""

import numpy as np
import pytest

from gaussray.prepare.calibrated_cameras import check_calibrated_cameras
from gaussray.prepare.calibrations.assign import assign_cameras
from gaussray.prepare.calibrations.known_camera import Calibration, KnownCamera
from gaussray.prepare.calibrations.opencv_pose import NO_POSE
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


@pytest.fixture
def check(tmp_path):
    """Checks the videos of some names with a calibration."""

    def run(known, *videos):
        sources = [
            Source(name, tmp_path / f"{name}.mp4", (), np.arange(3.0), ((4, 3),)) for name in videos
        ]
        given, _, absent = assign_cameras(known, sources)
        check_calibrated_cameras(list(given), absent, known.left_out)

    return run


def calibration(*names, **options):
    # Each camera is one farther along x.
    poses = [np.column_stack([np.eye(3), (k, 0.0, 0.0)]) for k in range(len(names))]
    cameras = [
        KnownCamera(name, {"w": 4, "h": 3}, pose) for name, pose in zip(names, poses, strict=True)
    ]
    return Calibration(cameras, **options)


def test_a_single_camera_is_refused_with_those_that_have_no_video(check):
    with pytest.raises(PrepareError, match="got cam0_test alone: .* have none: c1, c2.") as told:
        check(calibration("c0", "c1", "c2"), "cam0_test")
    assert "leave poses.calibration out" in str(told.value)
    with pytest.raises(PrepareError, match="got c0 alone: (?!.*Add the videos)"):
        check(calibration("c0"), "c0")


def test_a_camera_without_a_name_is_not_one_that_has_no_video(check):
    with pytest.raises(PrepareError, match="got cam alone: (?!.*Add the videos)"):
        check(calibration("1", in_order=True), "cam")


def test_what_the_file_lacks_of_another_camera_is_told(check):
    known = calibration("c0", left_out={"c1": NO_POSE})
    with pytest.raises(PrepareError, match="c1 does not count, because it has no R .* and t "):
        check(known, "c0")


def test_two_cameras_are_enough(check):
    check(calibration("c0", "c1", "c2"), "c0", "c1")
