"""NumPy's .npz files of projections, and projections in JSON."""

import json
import re

import numpy as np
import pytest
from quads import arc

from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


POSES = np.array(arc(3))
MATRIX = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
PROJECTIONS = MATRIX @ POSES
CLOSE = 1e-9


def write(path, **values):
    np.savez(path, **values)
    return path


def check(cameras, names):
    assert [one.name for one in cameras] == list(names)
    for one, pose in zip(cameras, POSES, strict=True):
        assert one.pose == pytest.approx(pose, abs=CLOSE)
        found = [one.lens[key] for key in ("fl_x", "fl_y", "cx", "cy")]
        assert found == pytest.approx([500, 505, 310.75, 243], rel=CLOSE)


@pytest.mark.parametrize("key", ["P", "proj", "projections", "proj_mats", "projection_matrices"])
@pytest.mark.parametrize("rows", [3, 4])
def test_an_array_of_projections(tmp_path, capsys, key, rows):
    stack = PROJECTIONS
    if rows == 4:
        stack = np.concatenate([stack, np.broadcast_to([0.0, 0, 0, 1], (3, 1, 4))], axis=1)
    path = write(tmp_path / "a.npz", **{key: stack}, names=["a", "b", "c"], size=[640, 480])
    for place in (path, tmp_path):
        cameras = read_calibration(place).cameras
        check(cameras, "abc")
        assert {(one.lens["w"], one.lens["h"]) for one in cameras} == {(640, 480)}
    assert f"{key} is split into K and [R | t]" in capsys.readouterr().out
    check(read_calibration(write(path, **{key: stack})).cameras, "012")
    assert f"the 3 cameras are called by their place in {key}, from 0." in capsys.readouterr().out


@pytest.mark.parametrize("form", ["P{}", "P_{}", "proj_{}", "projection_matrix_{}"])
@pytest.mark.parametrize("names", ["123", "012"])
def test_an_array_for_each_camera(tmp_path, form, names):
    values = {form.format(n): p for n, p in zip(names, PROJECTIONS, strict=True)}
    check(read_calibration(write(tmp_path / "a.npz", **values)).cameras, names)


def test_an_array_for_each_camera_may_have_its_name_behind_a_dash(tmp_path):
    values = {f"proj_{n}": p for n, p in zip("abc", PROJECTIONS, strict=True)}
    check(read_calibration(write(tmp_path / "a.npz", **values)).cameras, "abc")


def test_two_digits_keep_their_order(tmp_path):
    values = {f"P{n}": PROJECTIONS[k] for k, n in enumerate((2, 9, 10))}
    check(read_calibration(write(tmp_path / "a.npz", **values)).cameras, ["2", "9", "10"])


def test_a_rectification_alone_is_no_calibration(tmp_path):
    values = {"P1": PROJECTIONS[0], "P2": PROJECTIONS[1], "R1": np.eye(3), "R2": np.eye(3)}
    with pytest.raises(PrepareError, match=r"must hold K1, D1, .* \(or P, 3 x 4\) of several"):
        read_calibration(write(tmp_path / "a.npz", **values))


@pytest.mark.parametrize(
    ("stack", "message"),
    [
        (-PROJECTIONS, "camera 0: the first three columns of P must have a positive determinant"),
        (POSES, "camera 0: P must be a projection K .* got a rotation and a translation without"),
        (np.full((3, 3, 4), np.nan), "P must be finite numbers, 3 x 4 for each camera"),
        (np.tile(np.eye(4), (2, 1, 1)) * 2, "with no fourth row or 0 0 0 1, got the row"),
    ],
)
def test_what_is_no_projection_is_named(tmp_path, stack, message):
    with pytest.raises(PrepareError, match=message):
        read_calibration(write(tmp_path / "a.npz", P=stack))


def test_projections_in_json_are_read(tmp_path):
    path = tmp_path / "a.json"
    cameras = zip("abc", PROJECTIONS, strict=True)
    path.write_text(json.dumps({name: {"P": matrix.tolist()} for name, matrix in cameras}))
    check(read_calibration(path).cameras, "abc")


@pytest.mark.parametrize("others", [{}, {"P2": PROJECTIONS[1]}])
def test_two_arrays_of_one_camera_are_refused(tmp_path, others):
    path = write(tmp_path / "a.npz", P1=PROJECTIONS[0], p_1=PROJECTIONS[2], **others)
    told = "P1 and p_1, which are both of camera 1" if others else "must hold"
    with pytest.raises(PrepareError, match=told):
        read_calibration(path)


def test_skew_says_what_a_zero_costs(tmp_path):
    skewed = MATRIX + [[0, 5.05, 0], [0, 0, 0], [0, 0, 0]]
    path = tmp_path / "a.npz"
    with pytest.raises(PrepareError, match="if 2.4 pixels 24. rows from row 24. do not") as error:
        read_calibration(write(path, P=skewed @ POSES))
    # What is to be written in the place of each is the projection without skew.
    found = re.findall(
        r"(?:by row,|write) ((?:[-+.e\d]+ ){11}[-+e\d]+(?:\.\d+)?)", str(error.value)
    )
    numbers = np.array([list(map(float, one.split())) for one in found])
    assert numbers == pytest.approx(PROJECTIONS.reshape(3, 12), rel=1e-9, abs=1e-9)
    assert "So has camera 2 (2.4 pixels" in str(error.value)
    check(read_calibration(write(path, P=numbers.reshape(3, 3, 4))).cameras, "012")


def test_skew_of_less_than_a_pixel_at_the_border_is_left_out(tmp_path, capsys):
    skewed = MATRIX + [[0, 2.0, 0], [0, 0, 0], [0, 0, 0]]  # 0.004 of the focal length
    check(read_calibration(write(tmp_path / "a.npz", P=skewed @ POSES)).cameras, "012")
    told = "Skew is left out, which costs at most 0.96 pixels at the border."
    assert told in capsys.readouterr().out
