"""What no camera can do is refused with key and rule."""

import dataclasses

import pytest
import toy

from gaussray.render.rig.rig import RigOptions, ShutterOptions
from gaussray.render.rig.validate import check_cameras


# Two cameras, each of three frames that are 1/2 apart.
RECORDS = toy.records(cameras=("cam_0", "cam_1"))


def options(**shutter):
    return RigOptions(shutter=ShutterOptions(**{"kind": "rolling", **shutter}))


def test_a_camera_of_every_day_is_possible():
    check_cameras(RigOptions(), RECORDS)
    # As long as a frame: a shutter angle of 360 degrees.
    check_cameras(options(exposure=0.5, readout=0.3), RECORDS)
    # A single frame has no other that it could run into, and what is kept was filmed.
    check_cameras(options(exposure=2.0), RECORDS[:1])
    check_cameras(options(kind="keep", exposure=2.0), RECORDS)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (options(exposure=0.51), "shutter.exposure must be at most the 0.5 from one frame"),
        (options(readout=-0.1), "shutter.readout must be at least 0, got -0.1"),
    ],
)
def test_what_is_impossible_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        check_cameras(wrong, RECORDS)


def test_the_closest_frames_of_any_camera_decide():
    late = [dataclasses.replace(r.camera, time=r.camera.time / 4) for r in RECORDS[3:]]
    close = [dataclasses.replace(r, camera=c) for r, c in zip(RECORDS[3:], late, strict=True)]
    with pytest.raises(ValueError, match="at most the 0.125 from one frame"):
        check_cameras(options(exposure=0.2), [*RECORDS[:3], *close])
