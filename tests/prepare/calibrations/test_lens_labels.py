"""Labels that say the model of a lens, in files of cameras with poses."""

import json

import numpy as np
import pytest

from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.calibrations.lens_labels import is_fisheye
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


CAMERA = {
    "K": [[500.0, 0, 320], [0, 500, 240], [0, 0, 1]],
    "R": np.eye(3).tolist(),
    "t": [0, 0, 1],
    "dist": [0.1, 0.2, 0.3, 0.4],
}
FISHEYES = [
    {"fisheye": True},
    {"fisheye": "true"},
    {"fisheye": " Yes"},
    {"fisheye_model": 1},
    {"camera_model": "OPENCV_FISHEYE"},
    {"distortion_model": "equidistant"},
    {"distortion_models": "fisheye"},
]
PINHOLES = [
    {"fisheye": False},
    {"camera_model": "FULL_OPENCV"},
    {"camera_model": "pinhole", "distortion_model": "plumb_bob"},
    {"distortion_model": None},
    {"distortion_model": "brown_conrady"},
    {"fisheye": "false"},
    *({"camera_model": name} for name in ("perspective", "SIMPLE_PINHOLE", "rectilinear")),
]


def write(path, content):
    path.write_text(json.dumps(content))
    return path


def check(cameras, fisheye=True):
    for one in cameras:
        names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2")
        assert one.lens["camera_model"] == ("OPENCV_FISHEYE" if fisheye else "OPENCV")
        assert [one.lens[name] for name in names] == CAMERA["dist"]


@pytest.mark.parametrize("label", FISHEYES)
def test_a_fisheye_is_known_by_its_label(tmp_path, label):
    one = {**CAMERA, **label}
    check(read_calibration(write(tmp_path / "a.json", {"a": one, "b": one})).cameras)
    (tmp_path / "a.json").unlink()
    for name in "ab":
        write(tmp_path / f"{name}.json", one)
    check(read_calibration(tmp_path).cameras)


@pytest.mark.parametrize("label", FISHEYES)
def test_a_label_at_the_top_is_of_all_cameras_without_their_own(tmp_path, label):
    (key,) = label
    own = {key: "none" if key.endswith(("model", "models")) and "fish" not in key else False}
    cameras = {"a": CAMERA, "b": {**CAMERA, **own}, "c": {**CAMERA, key: None}}
    by_value = {key: {"a": value} for key, value in CAMERA.items()}
    path = tmp_path / "a.json"
    check(read_calibration(write(path, {**by_value, **label})).cameras)
    for content in ({**cameras, **label}, {"cameras": cameras, **label}):
        first, second, third = read_calibration(write(path, content)).cameras
        check([first, third])
        check([second], fisheye=False)
        assert read_lenses(path) == {"a": first.lens, "b": second.lens, "c": third.lens}


@pytest.mark.parametrize("own", [{"camera_model": "pinhole"}, {"camera_model": None}])
def test_a_label_of_another_meaning_leaves_that_of_all(tmp_path, own):
    content = {"distortion_model": "equidistant", "cameras": {"a": {**CAMERA, **own}}}
    (one,) = read_calibration(write(tmp_path / "a.json", content)).cameras
    check([one])
    assert read_lenses(tmp_path / "a.json") == {"a": one.lens}


@pytest.mark.parametrize(
    ("label", "message"),
    [
        ({"fisheye": "maybe"}, "a: fisheye must be true or false, got maybe"),
        ({"fisheye": True, "distortion_model": "radtan"}, "fisheye: true with the model radtan"),
        ({"fisheye": False, "distortion_model": "equi"}, "fisheye: false with the model equi"),
        ({"fisheye": 0, "camera_model": "fisheye"}, "fisheye: false with the model fisheye"),
    ],
)
def test_labels_that_say_neither_or_both_are_refused(label, message):
    with pytest.raises(PrepareError, match=message):
        is_fisheye("a", label)


@pytest.mark.parametrize("label", PINHOLES)
def test_other_labels_are_pinholes(tmp_path, label):
    check(read_calibration(write(tmp_path / "a.json", {"a": {**CAMERA, **label}})).cameras, False)


@pytest.mark.parametrize("value", [{}, [], [[1], [2, 3]], [1, 1], "", None])
def test_a_label_of_another_kind_says_no_fisheye(value):
    assert not is_fisheye("a", {"fisheye": value})


def test_models_that_opencv_has_not_are_refused(tmp_path):
    path = write(tmp_path / "a.json", {"a": {**CAMERA, "camera_model": "omni"}})
    with pytest.raises(PrepareError, match="a.json, camera a: must be a pinhole .* got omni with"):
        read_calibration(path)
    path = write(path, {"a": {**CAMERA, "fisheye": True, "dist": [0.1] * 5}})
    with pytest.raises(PrepareError, match="at most 4 .* got 5. OpenCV's fisheye has k1 to k4"):
        read_calibration(path)
