"""Captures of Record3D: the frames of an iPhone that moves."""

import json

import numpy as np
import pytest
from known_photograph import PIXELS, PLACE, TURN, H, W, pixels, seen_points
from PIL import Image
from scipy.spatial.transform import Rotation

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.record3d import read_record3d
from gaussray.capture.open import format_of, open_capture


K = np.array([[50.0, 0, 33.5], [0, 52.0, 22], [0, 0, 1]])
# ARKit's cameras look along -z, +y up.
QUAT = Rotation.from_matrix(TURN @ np.diag([1, -1, -1])).as_quat().tolist()
POSES = [[0, 0, 0, 1, 0, 0, 0], [*QUAT, *PLACE], [0, 0, 0, 2, 1, 2, 3]]


def lay(folder, name="metadata.json", pictures="rgb", **more):
    content = {"w": W, "h": H, "K": K.T.ravel().tolist(), "fps": 60, "dw": 8, "dh": 6}
    content |= {"poses": POSES, "initPose": POSES[0], "cameraType": 1}
    content["frameTimestamps"] = [0, 0.02, 0.05]
    content |= more
    content = {key: value for key, value in content.items() if value is not None}
    (folder / name).write_text(json.dumps(content))
    for k in range(3):
        (folder / pictures).mkdir(exist_ok=True)
        Image.fromarray(np.zeros((H, W, 3), np.uint8)).save(folder / pictures / f"{k}.jpg")
    return folder


def expected(own, k=K):
    return (own @ k.T)[:, :2] / own[:, 2:]


def test_pixels_and_times_are_those_of_the_frames(tmp_path):
    assert format_of(lay(tmp_path)) == "record3d"
    capture = open_capture(tmp_path)
    assert [view.time for view in capture.views] == [0, 0.02, 0.05]
    assert capture.time_unit == "seconds" and capture.time_range == (0, 0.05)
    assert {(view.camera_name, view.split) for view in capture.views} == {("record3d", "train")}
    world, own = seen_points()
    np.testing.assert_allclose(pixels(capture.views[1], world), expected(own), atol=PIXELS)
    # A quaternion may have any length; the camera looks along -z from (1, 2, 3).
    own = (world - (1, 2, 3)) * (1, -1, -1) + (0, 0, 20)
    seen = pixels(capture.views[2], world - (0, 0, 20))
    np.testing.assert_allclose(seen, expected(own), atol=PIXELS)


def test_each_frame_may_have_a_lens_and_time_may_follow_from_the_rate(tmp_path):
    lenses = [[50, 50, 30, 20], [60, 61, 31, 21], [70, 70, 32, 22]]
    lay(tmp_path, perFrameIntrinsicCoeffs=lenses, frameTimestamps=None)
    views = open_capture(tmp_path).views
    world, own = seen_points()
    k = np.array([[60, 0, 31], [0, 61, 21], [0, 0, 1]])
    np.testing.assert_allclose(pixels(views[1], world), expected(own, k), atol=PIXELS)
    assert views[2].time == pytest.approx(2 / 60)


def test_an_unpacked_archive_is_read_and_frames_without_picture_are_left_out(tmp_path):
    lay(tmp_path, "metadata", "rgbd")
    (tmp_path / "rgbd/1.jpg").unlink()
    with pytest.warns(CaptureWarning, match="1 of 3 frames have no picture"):
        assert [view.image.name for view in open_capture(tmp_path).views] == ["0.jpg", "2.jpg"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"poses": []}, "poses must be a list of at least one pose"),
        ({"poses": [POSES[0], [1, 2], POSES[2]]}, "frame 1: poses must be a list of seven"),
        ({"poses": [[0] * 7, *POSES[1:]]}, "frame 0: poses must be .* not zero"),
        ({"K": K.tolist()}, "K must be a list of 9 finite numbers"),
        ({"K": K.ravel().tolist()}, "K must be a matrix, column by column"),
        ({"frameTimestamps": [0, 1]}, "frameTimestamps must be a list of 3, as poses is"),
        ({"perFrameIntrinsicCoeffs": [[1, 2, 3, 4]]}, "perFrameIntrinsicCoeffs must be a list of"),
        ({"perFrameIntrinsicCoeffs": [[1], [2], [3]]}, "frame 0: perFrameIntrinsicCoeffs must"),
        ({"frameTimestamps": [0, 1, 1e300]}, "frame 2: frameTimestamps must be at most 1e.30 sec"),
        ({"frameTimestamps": [2, 1, 0]}, "frame 1: frameTimestamps must be later than 2, that of "),
        ({"frameTimestamps": [0, 1, 1]}, "frame 2: frameTimestamps must be later than 1, that of "),
        ({"frameTimestamps": None, "fps": 0}, "fps must be above 0"),
        ({"frameTimestamps": None, "fps": 1e-300}, r"fps must be from 1e-20 to 1e\+20, got 1e-300"),
        ({"frameTimestamps": None, "fps": 1e300}, r"fps must be from 1e-20 to 1e\+20, got 1e\+300"),
        ({"w": 0.5}, "w must be a whole number"),
    ],
)
def test_what_contradicts_the_format_is_named(tmp_path, change, says):
    with pytest.raises(CaptureError, match=rf"metadata.json.* {says}|metadata.json: {says}"):
        open_capture(lay(tmp_path, **change))


@pytest.mark.parametrize("length", [1e308, 1e-310])
def test_a_quaternion_may_have_any_length(tmp_path, length):
    lay(tmp_path, poses=[*POSES[:2], [*(length * np.array(QUAT)), *PLACE]])
    views = open_capture(tmp_path).views
    found, same = (view.camera.trajectory.quat for view in views[1:])
    np.testing.assert_allclose(found, same, atol=1e-6)


def test_times_since_1970_are_times(tmp_path):
    lay(tmp_path, frameTimestamps=[1.7e9, 1.7e9 + 0.02, 1.7e9 + 0.05])
    with pytest.warns(CaptureWarning, match="times are counted from the first"):
        times = [view.time for view in open_capture(tmp_path).views]
    np.testing.assert_allclose(times, [0, 0.02, 0.05], atol=1e-6)


def test_other_metadata_is_none_of_it(tmp_path):
    lay(tmp_path, poses=None)
    with pytest.raises(CaptureError, match="of a known format|files of one format"):
        open_capture(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"holds no metadata\.json of Record3D"):
        read_record3d(tmp_path)
