"""Known lenses of cameras whose poses are estimated."""

import json
from pathlib import Path

import numpy as np
import pytest

from gaussray.prepare.errors import PrepareError
from gaussray.prepare.given_lens import given_lenses
from gaussray.prepare.options import PosesOptions
from gaussray.prepare.sources import Source


NUMBERS = (500.0, 505.0, 310.0, 242.0, -0.2, 0.05, 0.001, 0.002)


def source(name="cam1", *sizes):
    sizes = sizes or ((640, 480),)
    pictures = tuple(Path(f"{k}.png") for k in range(len(sizes)))
    return Source(name, Path(name), pictures, np.zeros(0), sizes)


def lens_file(folder, **focals):
    """A file with a lens of each name, of pictures of 640 x 480."""
    path = folder / "rig.json"
    cameras = {
        name: {"K": [[f, 0, 320], [0, f, 240], [0, 0, 1]], "dist": [0.1, 0, 0, 0]}
        | {"size": [640, 480]}
        for name, f in focals.items()
    }
    path.write_text(json.dumps(cameras))
    return str(path)


def test_numbers_are_a_lens_of_pictures_of_any_one_size(capsys):
    lenses, remarks = given_lenses(NUMBERS, [source("a"), source("b")])
    assert not remarks and list(lenses) == [("a", (640, 480)), ("b", (640, 480))]
    for lens in lenses.values():
        assert (lens["w"], lens["h"]) == (640, 480)
        # OpenCV's pixel centres are at whole numbers.
        assert (lens["fl_x"], lens["fl_y"], lens["cx"], lens["cy"]) == (500, 505, 310.5, 242.5)
        assert [lens[key] for key in ("k1", "k2", "p1", "p2")] == list(NUMBERS[4:])
    (bare,) = given_lenses(NUMBERS[:4], [source()])[0].values()
    assert bare["camera_model"] == "OPENCV" and "k1" not in bare
    assert "fx=500 fy=505 (65.2 degrees across), no distortion" in capsys.readouterr().out


def test_a_lens_is_scaled_with_its_pictures_and_a_warning(tmp_path):
    one = source("cam1", (640, 480), (320, 240), (320, 240))
    lenses, (remark,) = given_lenses(lens_file(tmp_path, any=400.0), [one])
    assert lenses["cam1", (640, 480)]["fl_x"] == 400
    half = lenses["cam1", (320, 240)]
    assert (half["fl_x"], half["cx"], half["k1"]) == (200, 160.25, 0.1)
    assert "640 x 480 for pictures of 320 x 240; it is scaled" in remark.text


def test_pictures_of_another_shape_are_refused(tmp_path):
    with pytest.raises(
        PrepareError, match="cam1: poses.lens must be .* got 640 x 480 for pictures"
    ):
        given_lenses(lens_file(tmp_path, any=400.0), [source("cam1", (480, 640))])
    sizes = (640, 480), (320, 240)
    for cameras in ([source("cam1", *sizes)], [source("a", sizes[0]), source("b", sizes[1])]):
        with pytest.raises(PrepareError, match="have one size then, got 640 x 480, 320 x 240"):
            given_lenses(NUMBERS, cameras)


def test_one_lens_serves_all_and_several_those_of_their_names(tmp_path, capsys):
    cameras = [source("cam1"), source("cam2")]
    for names in ({"x": 400.0}, {"x": 400.0, "y": 400.0}):
        lenses, _ = given_lenses(lens_file(tmp_path, **names), cameras)
        assert {lens["fl_x"] for lens in lenses.values()} == {400}
    lenses, _ = given_lenses(lens_file(tmp_path, c2=500.0, c1=400.0), cameras)
    assert [lens["fl_x"] for lens in lenses.values()] == [400, 500]
    assert "The lens of rig.json stays as it is" in capsys.readouterr().out
    with pytest.raises(PrepareError, match="got none of cam2 among cam1, front"):
        given_lenses(lens_file(tmp_path, cam1=400.0, front=500.0), cameras)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lens": (1.0, 2.0, 3.0)}, r"poses.lens must be .*\[fx,fy,cx,cy\].* got 3 numbers"),
        ({"lens": NUMBERS, "fov": 70.0}, "must be null with poses.fov"),
        ({"lens": "a.yaml", "calibration": "b.yaml"}, "must be null with poses.calibration"),
    ],
)
def test_options_that_contradict_each_other_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        PosesOptions(**options)


def test_one_of_several_lenses_serves_one_camera(tmp_path):
    path = lens_file(tmp_path, cam1=400.0, cam2=500.0)
    # Both are called 2 by their last numbers.
    with pytest.raises(PrepareError, match="got cam2 for cam1_take2 and cam2_take2"):
        given_lenses(path, [source("cam1_take2"), source("cam2_take2")])
    same = lens_file(tmp_path, cam1=400.0, cam2=400.0)
    assert len(given_lenses(same, [source("cam1_take2"), source("cam2_take2")])[0]) == 2


def test_turned_pictures_are_called_so(tmp_path):
    with pytest.raises(PrepareError, match="These pictures are turned"):
        given_lenses(lens_file(tmp_path, any=400.0), [source("cam1", (480, 640))])


def test_a_focal_length_is_above_zero():
    with pytest.raises(ValueError, match="fx and fy above 0"):
        PosesOptions(lens=(-5.0, 5.0, 3.0, 2.0))
