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
        ({"dist": {"rows": 1, "cols": 4, "data": FOUR}}, FOUR),
        ({"dist": FOUR, "k1": 0.1}, FOUR),
        ({"dist": None, "D": FOUR}, FOUR),
    ],
)
def test_both_readers_take_the_same_coefficients(tmp_path, own, numbers):
    assert coefficients(write(tmp_path, {"a": {**CAMERA, **own}})) == {"a": numbers}


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"dist": [0.1, 0.2, 0.3]}, "camera a: dist must be 2 or 4 .* got 3"),
        ({"dist": [0.1]}, "camera a: dist must be 2 or 4 .* got 1"),
        ({"k1": 0.1, "k2": 0.2}, "camera a: distortion must be one list .* got k1, k2"),
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


@pytest.mark.parametrize("top", [{"dist": 0.1}, {"dist": "x"}, {"k1": 0.1, "k2": 0}])
def test_distortion_at_the_top_that_is_no_list_is_refused(tmp_path, top):
    path = write(tmp_path, {"cameras": {"a": CAMERA}, **top})
    for reader in (read_calibration, read_lenses):
        with pytest.raises(PrepareError, match="camera a: dist.* must be"):
            reader(path)


def test_cameras_may_be_called_like_coefficients(tmp_path):
    content = {"k1": {**CAMERA, "dist": FOUR}, "d": CAMERA}
    assert coefficients(write(tmp_path, content)) == {"d": [0] * 4, "k1": FOUR}
    assert not len(distortion_in("a", CAMERA))
