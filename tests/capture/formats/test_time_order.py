"""Times of one camera: each is later than the one before, and none is too far from 0."""

import math
from pathlib import Path

import pytest

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.time_order import LATEST, check_later


@pytest.mark.parametrize(
    ("time", "message"),
    [
        (1.0, "time must be later than 1, that of frame 3"),
        (0.5, "time must be later than 1, that of frame 3"),
        (math.nan, "time must be at most 1e.30 seconds from 0"),
        (math.inf, "time must be at most 1e.30 seconds from 0"),
        (-2 * LATEST, "time must be at most 1e.30 seconds from 0"),
    ],
)
def test_times_that_no_camera_has_are_refused(time, message):
    with pytest.raises(CaptureError, match=f"a.json.*: {message}, got"):
        check_later(Keys(Path("a.json"), {"time": time}), "time", time, 1.0, "that of frame 3")


def test_the_first_time_may_be_any_and_the_latest_is_one():
    for time, before in ((-5.0, -math.inf), (LATEST, -5.0)):
        check_later(Keys(Path("a.json"), {"time": time}), "time", time, before, "of another")
