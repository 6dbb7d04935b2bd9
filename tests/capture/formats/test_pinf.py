"""Smoke as PINF and HyFluid have it: an info.json and a video for each camera."""

import copy
import json

import films
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.camera import project
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.pinf import read_pinf
from gaussray.capture.open import format_of, open_capture


# Single precision through lens and pose, in pixels.
PIXELS = 1e-3
W, H, COUNT = 32, 48, 5
ANGLE = 0.4


def pose(x=0.0):
    """A camera at z = 4 that looks along -z."""
    return [[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]


def listed(name, **changes):
    video = {"file_name": f"{name}.mp4", "frame_rate": 30, "frame_num": COUNT}
    # The files' pictures are twice as large as the videos'.
    video |= {"camera_angle_x": ANGLE, "camera_hw": [2 * H, 2 * W], "transform_matrix": pose()}
    return video | changes


INFO = {
    "train_videos": [listed("a"), listed("b", transform_matrix=pose(1.0))],
    "test_videos": [listed("c")],
    "near": 1.1,
}


@pytest.fixture
def folder(tmp_path):
    for name in "abc":
        films.film(tmp_path / f"{name}.mp4", films.shades(COUNT, W, H))
    lay(tmp_path, INFO)
    return tmp_path


def lay(folder, info):
    (folder / "info.json").write_text(json.dumps(info))


def changed(**changes):
    info = copy.deepcopy(INFO)
    for key, value in changes.items():
        if value is None:
            del info["train_videos"][0][key]
        else:
            info["train_videos"][0][key] = value
    return info


def test_videos_are_cameras_and_those_of_the_test_are_held_out(folder):
    assert format_of(folder) == "pinf"
    capture = open_capture(folder)
    assert [view.camera_name for view in capture.views] == [c for c in "abc" for _ in range(COUNT)]
    assert {view.camera_name for view in capture.views if view.split == "test"} == {"c"}
    assert [view.time for view in capture.views[:COUNT]] == [i / COUNT for i in range(COUNT)]
    assert (capture.time_range, capture.time_unit) == ((0.0, 0.8), "normalised")
    assert [films.index_of(p) for p in films.load(capture.views)] == [*range(COUNT)] * 3


def test_a_point_lies_where_angle_and_matrix_put_it(folder):
    capture = read_pinf(folder)
    point = jnp.asarray([0.2, 0.1, 0.0], jnp.float32)
    focal = W / 2 / np.tan(ANGLE / 2)
    for view, x in zip(capture.views[::COUNT], (0.0, 1.0, 0.0), strict=True):
        place = project(view.camera, point)
        expected = [W / 2 + focal * (0.2 - x) / 4, H / 2 - focal * 0.1 / 4]
        np.testing.assert_allclose(np.asarray(place), expected, atol=PIXELS)


def test_a_camera_that_moves_has_a_matrix_for_each_frame(folder):
    path = [pose(0.1 * i) for i in range(COUNT)]
    lay(folder, changed(transform_matrix=None, transform_matrix_list=path))
    place = [np.asarray(v.camera.trajectory.translation)[0] for v in read_pinf(folder).views]
    np.testing.assert_allclose(place[:COUNT], [[0.1 * i, 0, 4] for i in range(COUNT)], atol=PIXELS)


def test_the_first_frames_are_read_if_there_are_more(folder):
    lay(folder, changed(frame_num=2))
    views = [view for view in read_pinf(folder).views if view.camera_name == "a"]
    assert [view.time for view in views] == [0.0, 0.5]
    lay(folder, changed(frame_num=None, frame_rate=None, camera_hw=None))
    assert len(read_pinf(folder).views) == 3 * COUNT


def test_videos_of_a_third_split_are_left_out_with_a_warning(folder):
    lay(folder, INFO | {"val_videos": [listed("c")], "test_videos": []})
    with pytest.warns(CaptureWarning, match="val_videos are not read"):
        capture = read_pinf(folder)
    assert {view.camera_name for view in capture.views} == {"a", "b"}


@pytest.mark.parametrize(
    ("info", "says"),
    [
        ([], "train_videos must be a list of at least one video"),
        ({"train_videos": []}, "train_videos must be a list of at least one video"),
        ({"train_videos": 3}, "train_videos must be a list of videos"),
        ({"train_videos": ["a.mp4"]}, "train_videos must be a list of videos"),
        (changed(file_name=None), r"train_videos\[0\].file_name must be a text"),
        (changed(file_name="../a.mp4"), r"train_videos\[0\].file_name"),
        (changed(camera_angle_x=None), r"train_videos\[0\].camera_angle_x must be a number"),
        (changed(camera_angle_x=3.2), r"\[0\].camera_angle_x must be .* below pi, got 3.2"),
        (changed(frame_num=6), r"\[0\].frame_num must be at most 5, as a.mp4 has frames, got 6"),
        (changed(frame_num=0), r"\[0\].frame_num must be a whole number of at least 1"),
        (changed(camera_hw=[W, H]), r"\[0\].camera_hw must be .* 48 x 32, got .*without cropping"),
        (changed(camera_hw=[H, 0]), r"\[0\].camera_hw must be"),
        (changed(transform_matrix=None), r"\[0\].transform_matrix must be a rigid"),
        (changed(transform_matrix=[[1]]), r"\[0\].transform_matrix must be a rigid"),
        (changed(transform_matrix_list=[pose()]), r"transform_matrix_list must be a list of 5"),
    ],
)
def test_what_contradicts_the_format_is_named(folder, info, says):
    lay(folder, info)
    with pytest.raises(CaptureError, match=says):
        read_pinf(folder)


def test_missing_files_are_named(folder):
    (folder / "b.mp4").unlink()
    with pytest.raises(FileNotFoundError, match="b.mp4"):
        read_pinf(folder)
    (folder / "info.json").unlink()
    with pytest.raises(FileNotFoundError, match="info.json"):
        read_pinf(folder)


@pytest.mark.parametrize("content", ["{}", "[1]"])
def test_an_info_file_of_another_kind_is_no_capture(folder, content):
    (folder / "info.json").write_text(content)
    with pytest.raises(CaptureError, match="pinf needs info.json with train_videos"):
        format_of(folder)
