"""Cameras whose times have another unit than the others' are named."""

import dataclasses
import warnings

import numpy as np
import pytest
import toy

from gaussray.capture.camera_clocks import warn_of_other_clocks
from gaussray.capture.errors import CaptureWarning
from gaussray.capture.formats.paired import read_capture


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return read_capture(toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene()))


def of_times(capture, times):
    """The capture with pictures of each camera at some times."""
    view = capture.views[0]
    views = [
        dataclasses.replace(view, camera_name=name, time=float(time))
        for name, own in times.items()
        for time in own
    ]
    return dataclasses.replace(capture, views=views)


def test_a_camera_that_counts_frames_among_seconds_is_named(capture):
    seconds, frames = np.arange(30) / 5, np.arange(31)
    with pytest.warns(CaptureWarning, match="31 pictures of c have times from 0 to 30, .* to 5.8"):
        warn_of_other_clocks(of_times(capture, {"a": seconds, "b": seconds, "c": frames}))
    with pytest.warns(CaptureWarning, match="of b have times from 0 to 29, .* from 0 to 5.8"):
        warn_of_other_clocks(of_times(capture, {"a": seconds, "b": np.arange(30)}))
    with pytest.warns(CaptureWarning, match="of b and of 1 other cameras"):
        times = {name: seconds for name in "adef"} | {name: 9 * seconds for name in "bc"}
        warn_of_other_clocks(of_times(capture, times))


@pytest.mark.parametrize(
    "times",
    [
        # Another rate over the same time, a later start, a camera that was stopped early.
        {"a": np.arange(30) / 5, "b": np.arange(60) / 10, "c": np.arange(30) / 5 + 3},
        {"a": np.arange(30) / 5, "b": np.arange(10) / 5, "c": np.arange(30) / 5},
        # Too few to tell, one camera, one time.
        {"a": np.arange(3), "b": np.arange(3) * 9},
        {"a": np.arange(30)},
        {"a": np.zeros(9), "b": np.zeros(9)},
    ],
)
def test_usual_cameras_are_not(capture, times):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_other_clocks(of_times(capture, times))
