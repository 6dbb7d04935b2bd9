"""Coefficients of distortion, which poses.calibration and poses.lens read alike."""

import json

import numpy as np
import pytest

from gaussray.prepare.calibrations.distortions import distortion_in
from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


CAMERA = {
    "K": [[500.0, 0, 320], [0, 500, 240], [0, 0, 1]],
    "R": np.eye(3).tolist(),
    "t": [0, 0, 1],
}
FOUR = [0.1, 0.2, 0.3, 0.4]
NAMES = ("k1", "k2", "p1", "p2")


def write(folder, content):
    path = folder / "a.json"
    path.write_text(json.dumps(content))
    return path


def coefficients(path):
    """Those of each camera, which both readers must agree on."""
    cameras = {camera.name: camera.lens for camera in read_calibration(path).cameras}
    result = {name: [lens.get(key, 0) for key in NAMES] for name, lens in sorted(cameras.items())}
    lenses = read_lenses(path)
    assert {n: [lens.get(key, 0) for key in NAMES] for n, lens in lenses.items()} == result
    return result


@pytest.mark.parametrize(
    ("own", "numbers"),
    [
        ({"dist": [0.1, 0.2]}, [0.1, 0.2, 0, 0]),
        ({"dist": [0]}, [0, 0, 0, 0]),
        ({"dist": [0, 0, 0]}, [0, 0, 0, 0]),
        ({"k1": 0, "k2": 0.0}, [0, 0, 0, 0]),
        ({"dist": [0.1]}, [0.1, 0, 0, 0]),
        ({"dist": 0.1}, [0.1, 0, 0, 0]),
        ({"k1": 0.1, "k2": 0.2}, [0.1, 0.2, 0, 0]),
        ({"p2": 0.4, "k1": 0.1, "p1": [0.3], "k2": 0.2}, FOUR),
        ({"distortion": {"k1": 0.1, "k2": 0.2, "p1": 0.3, "p2": 0.4}}, FOUR),
        ({"dist": {"model": "plumb_bob", "data": FOUR}}, FOUR),
        ({"dist": {"rows": 1, "cols": 4, "data": FOUR}}, FOUR),
        ({"dist": FOUR, "k1": 0.1}, FOUR),
        ({"dist": FOUR, "k1": [0.1], "k2": None}, FOUR),
        ({"dist": [0.1, 0.2, 0.3, 0.4, 0.0], "k3": 0}, FOUR),
        ({"dist": None, "D": FOUR}, FOUR),
    ],
)
def test_both_readers_take_the_same_coefficients(tmp_path, own, numbers):
    assert coefficients(write(tmp_path, {"a": {**CAMERA, **own}})) == {"a": numbers}


@pytest.mark.parametrize(
    ("own", "message"),
    [
        (
            {"dist": [0.1, 0.2, 0.3]},
            r"dist must be OpenCV's 4, 5 or 8 .* got 3, which may be k1 k2 k3 \(write \[k1, k2, 0",
        ),
        (
            {"dist": [[0.1] * 6]},
            "a: dist must be .* got 6, which may be k1 to k6 .*Write them",
        ),
        ({"k1": 0.1, "k4": 0.2}, "a: k1, k2, k3 and k4 without p1 and p2 may be .* fisheye: true"),
        ({"k1": 0.1, "p1": 0.2, "fisheye": True}, "a: OpenCV's fisheye has k1 to k4, got p1"),
        ({"k1": [0.1, 0.2]}, "camera a: k1 must be a finite number, got 2. Write one number each"),
        (
            {"k1": 0.1, "dist": FOUR[::-1]},
            "a: k1 must not differ from the listed .* 0.1. Keep",
        ),
        ({"dist": FOUR, "k3": 0.01}, "a: k3 must not differ from the listed .* 0.01. Keep"),
        ({"dist": FOUR, "k1": [0.1, 0.1]}, "a: k1 must not differ from the listed"),
        ({"dist": [], "radial": [0.1, 0.2]}, "camera a: distortion must be one list .* got radial"),
        ({"dist": FOUR, "D": FOUR[::-1]}, "camera a: dist and D must not differ"),
    ],
)
def test_both_readers_refuse_what_would_be_zeros(tmp_path, own, message):
    path = write(tmp_path, {"a": {**CAMERA, **own}})
    for reader in (read_calibration, read_lenses):
        with pytest.raises(PrepareError, match=message):
            reader(path)


@pytest.mark.parametrize("top", [FOUR, {"rows": 1, "cols": 4, "data": FOUR}])
def test_distortion_at_the_top_is_of_all_cameras_without_their_own(tmp_path, top):
    cameras = {"a": CAMERA, "b": {**CAMERA, "D": [0.5, 0, 0, 0]}, "c": {**CAMERA, "dist": None}}
    found = {"a": FOUR, "b": [0.5, 0, 0, 0], "c": FOUR}
    for content in ({**cameras, "dist": top}, {"cameras": cameras, "dist": top}):
        assert coefficients(write(tmp_path, content)) == found
    by_value = {key: {"a": value} for key, value in CAMERA.items()}
    (one,) = read_calibration(write(tmp_path, {**by_value, "dist": top})).cameras
    assert [one.lens[key] for key in NAMES] == FOUR


@pytest.mark.parametrize("top", [{"dist": "x"}, {"radial": [0.1]}, {"dist": [1, 2, 3]}])
def test_distortion_at_the_top_that_is_no_list_is_refused(tmp_path, top):
    path = write(tmp_path, {"cameras": {"a": CAMERA}, **top})
    for reader in (read_calibration, read_lenses):
        with pytest.raises(PrepareError, match="camera a: dist.* must be"):
            reader(path)


@pytest.mark.parametrize("top", [{"dist": 0.1}, {"k1": 0.1, "k2": 0}])
def test_coefficients_at_the_top_may_be_single(tmp_path, top):
    path = write(tmp_path, {"cameras": {"a": CAMERA, "b": CAMERA}, **top})
    assert coefficients(path) == {"a": [0.1, 0, 0, 0], "b": [0.1, 0, 0, 0]}


def test_a_line_says_how_few_coefficients_are_taken(tmp_path, capsys):
    cameras = {"a": {**CAMERA, "dist": [0.1]}, "b": {**CAMERA, "D": [[0.1, 0.2]]}}
    path = write(tmp_path, cameras)
    for reader in (read_calibration, read_lenses):
        reader(path)
        told = capsys.readouterr().out
        assert f"{path}: a single distortion coefficient is taken as k1; the others are 0." in told
        assert "two distortion coefficients are taken as k1 and k2; the others are 0." in told
    coefficients(write(tmp_path, {"a": {**CAMERA, "dist": FOUR}}))
    assert "coefficient" not in capsys.readouterr().out


@pytest.mark.parametrize("label", [{"fisheye": True}, {"distortion_model": "equidistant"}])
def test_coefficients_under_keys_of_their_own_may_be_a_fisheyes(tmp_path, label):
    own = {"k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4, "p1": 0}
    path = write(tmp_path, {"a": {**CAMERA, **own, **label}})
    (camera,) = read_calibration(path).cameras
    assert camera.lens["camera_model"] == "OPENCV_FISHEYE"
    assert [camera.lens[key] for key in ("k1", "k2", "k3", "k4")] == FOUR
    assert read_lenses(path)["a"] == camera.lens


def test_six_radial_coefficients_under_keys_of_their_own_are_opencvs(tmp_path):
    own = {f"k{i}": i / 100 for i in range(1, 7)}
    with pytest.raises(PrepareError, match="may be of OpenCV's fisheye"):
        read_calibration(write(tmp_path, {"a": CAMERA | {f"k{i}": 0.1 for i in range(1, 5)}}))
    (camera,) = read_calibration(write(tmp_path, {"a": {**CAMERA, **own}})).cameras
    assert camera.lens["camera_model"] == "FULL_OPENCV"
    assert {key: camera.lens[key] for key in own} == own and camera.lens["p1"] == 0


def test_cameras_may_be_called_like_coefficients(tmp_path):
    content = {"k1": {**CAMERA, "dist": FOUR}, "d": CAMERA}
    assert coefficients(write(tmp_path, content)) == {"d": [0] * 4, "k1": FOUR}
    assert not len(distortion_in("a", CAMERA))


EXACT = [0.123456789, -0.0123, 0.0012345, 0.0]


@pytest.mark.parametrize(
    ("own", "told"),
    [
        ({"k1": 0.123457, "p1": 0.00123}, "k1, p1"),
        ({"k1": 0.123456789, "k2": -0.0123}, ""),
        ({"radial": [0.1, 0.2]}, "radial"),
    ],
)
def test_the_list_is_taken_where_others_are_rounded_or_not_read(tmp_path, capsys, own, told):
    path = write(tmp_path, {"a": {**CAMERA, "dist": EXACT, **own}})
    assert coefficients(path) == {"a": EXACT}
    said = capsys.readouterr().out
    assert (f"{told} beside the matrix or the list of coefficients" in said) == bool(told)
    assert ("beside the matrix" in said) == bool(told)


@pytest.mark.parametrize("own", [{"k1": 0.123458}, {"p1": 0.00124}, {"k2": 0.0123}])
def test_numbers_that_no_rounding_explains_are_refused(tmp_path, own):
    path = write(tmp_path, {"a": {**CAMERA, "dist": EXACT, **own}})
    with pytest.raises(PrepareError, match="must not differ from the listed coefficients"):
        read_calibration(path)


def test_arrays_of_all_cameras_beside_a_list_are_no_error_of_numpy(tmp_path):
    names, two = ["a", "b"], np.ones((2, 1))
    values = {key: np.array([value] * 2) for key, value in CAMERA.items()}
    path = tmp_path / "a.npz"
    np.savez(path, **values, names=names, dist=FOUR * two, radial=two * [0.1, 0.2])
    assert [camera.lens["k1"] for camera in read_calibration(path).cameras] == [0.1, 0.1]
    np.savez(path, **values, names=names, dist=FOUR * two, k1=np.array([0.1, 0.1]))
    with pytest.raises(PrepareError, match="k1 must not differ from the listed"):
        read_calibration(path)
