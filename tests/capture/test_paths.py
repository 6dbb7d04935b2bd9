"""Camera paths of every format are the same path, and what is none is named with its place."""

import json

import numpy as np
import pytest

from gaussray.capture.errors import CaptureError
from gaussray.capture.paths import lens_of_path, read_path


# Rotations pass through single precision.
SINGLE = 1e-6
TURN = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # 90 degrees about y
MATRICES = [np.eye(4), np.block([[TURN, np.array([[1.0], [2], [3]])], [np.zeros((1, 3)), 1]])]
# The same in our axes, +y down and +z forward: half a turn about x first.
QUAT = np.array([[0, 1, 0, 0], [0, 1, 0, -1] / np.sqrt(2)])


def listed(key="transform_matrix"):
    return [{"time": 2.0 * i, key: m.tolist()} for i, m in enumerate(MATRICES)]


def rows():
    pairs = zip((0.0, 2.0), MATRICES, QUAT, strict=True)
    lines = [(t, *m[:3, 3], *q[1:], q[0]) for t, m, q in pairs]
    return "# a comment\n\n" + "\n".join(" ".join(map(str, line)) for line in lines)


FILES = {
    "frames.json": {"frames": listed()},
    "list.json": {"trajectory": listed()},
    "block.json": {"trajectory": {"poses": listed(), "interpolation": "spline"}},
    "nerfstudio.json": {"camera_path": listed("camera_to_world"), "seconds": 2},
    "unrolled.json": {
        "camera_path": [{"camera_to_world": m.ravel().tolist(), "fov": 50} for m in MATRICES],
        "seconds": 2,
    },
    "tum.txt": rows(),
}


@pytest.mark.parametrize("name", FILES)
def test_every_format_is_the_same_path(tmp_path, name):
    content = FILES[name]
    (tmp_path / name).write_text(content if isinstance(content, str) else json.dumps(content))
    times, quat, place = read_path(tmp_path / name)
    np.testing.assert_array_equal(times, [0, 2])
    np.testing.assert_allclose(place, [(0, 0, 0), (1, 2, 3)])
    alike = np.abs(np.sum(quat / np.linalg.norm(quat, axis=1, keepdims=True) * QUAT, axis=1))
    np.testing.assert_allclose(alike, 1, atol=SINGLE)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", "0 1 2 3\n", "a.txt, line 1: must be time x y z qx qy qz qw"),
        ("a.txt", "0 1 2 3 0 0 0 0\n", "a quaternion that is not zero"),
        ("a.txt", "0 1 2 3 0 0 0 one\n", "eight finite numbers"),
        ("a.txt", "# nothing\n", "must hold at least one pose, got none"),
        ("a.txt", "1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "times of a path must strictly increase"),
        ("a.json", "{}", "trajectory.file must hold one of trajectory, frames, camera_path"),
        ("a.json", '{"frames": [3]}', "frames must be a list of blocks"),
        ("a.json", '{"frames": [{"time": 0}]}', r"frames\[0\].transform_matrix must be a rigid"),
    ],
)
def test_what_is_no_path_is_named_with_its_place(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(CaptureError, match=message):
        read_path(tmp_path / name)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(OSError, match="none.txt"):
        read_path(tmp_path / "none.txt")
    with pytest.raises(OSError, match="none.json"):
        read_path(tmp_path / "none.json")


@pytest.mark.parametrize(
    ("top", "pose", "want"),
    [
        ({"camera_angle_x": 0.9}, {}, ("camera_angle_x", 0.9, 51.566)),
        ({"fl_x": 100, "w": 200}, {}, ("fl_x", 100, 90.0)),
        ({}, {"fl_x": 100}, ("fl_x", 100, None)),
        ({}, {"fov": 90, "aspect": 1.0}, ("fov", 90, 90.0)),
        ({"render_width": 2, "render_height": 1}, {"fov": 90}, ("fov", 90, 126.870)),
        ({}, {"fov": 90}, ("fov", 90, None)),
        ({}, {"fov": 200, "aspect": 1.5}, ("fov", 200, None)),
        ({"camera_angle_x": 3.5}, {}, ("camera_angle_x", 3.5, None)),
        ({"camera_model": "OPENCV_FISHEYE", "w": 200}, {"fl_x": 100}, ("fl_x", 100, None)),
        ({"camera_type": "equirectangular"}, {"fov": 90, "aspect": 1.0}, ("fov", 90, None)),
        ({"fov": "wide", "camera_angle_x": True, "fl_x": -1}, {}, None),
        ({}, {}, None),
    ],
)
def test_the_field_of_view_of_a_path_is_told_and_not_read(tmp_path, top, pose, want):
    file = tmp_path / "a.json"
    file.write_text(json.dumps({**top, "frames": [{**entry, **pose} for entry in listed()]}))
    found = lens_of_path(file)
    if want is None:
        assert found is None
        return
    assert (found.key, found.least, found.largest) == (want[0], want[1], want[1])
    assert found.degrees == (want[2] and pytest.approx(want[2], abs=1e-3))


def test_a_text_of_poses_has_no_field_of_view(tmp_path):
    (tmp_path / "a.txt").write_text(rows())
    assert lens_of_path(tmp_path / "a.txt") is None
