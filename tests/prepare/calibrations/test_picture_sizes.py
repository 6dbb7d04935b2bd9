"""The size of calibrated pictures under its names, and lenses of unknown size."""

import json
from pathlib import Path

import numpy as np
import pytest
from quads import arc

from gaussray.prepare.calibrations.assign import assign_cameras
from gaussray.prepare.calibrations.known_camera import Calibration
from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.calibrations.picture_sizes import sides_in, size_in, sizes_in
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.calibrations.resized import resized_lens
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


POSES = arc(3)
MATRIX = [[500.0, 0, 319.5], [0, 505.0, 239.5], [0, 0, 1]]


def read(path, **more):
    content = {
        f"cam{k}": {"K": MATRIX, "R": pose[:, :3].tolist(), "t": pose[:, 3].tolist(), **more}
        for k, pose in enumerate(POSES, 1)
    }
    path.write_text(json.dumps(content))
    return read_calibration(path).cameras


@pytest.mark.parametrize(
    "said",
    [
        *({key: [640, 480]} for key in ("size", "imgSize", "img_size", "image_size", "imageSize")),
        *({key: [640, 480]} for key in ("resolution", "resolution_wh", "frame_size")),
        *({"width": 640, "height": 480}, {"image_width": 640, "image_height": 480}),
        *({"img_width": 640, "img_height": [480]}, {"w": 640.0, "h": 480.0}),
        *({"image_size": {"width": 640, "height": 480}}, {"size": None, "imgSize": [640, 480]}),
    ],
)
def test_a_size_is_read_under_its_names(tmp_path, said):
    lenses = [camera.lens for camera in read(tmp_path / "a.json", **said)]
    assert {(lens["w"], lens["h"]) for lens in lenses} == {(640, 480)}


def test_a_size_at_the_top_is_of_all_cameras(tmp_path):
    camera = {"K": MATRIX, "R": np.eye(3).tolist(), "t": [0, 0, 1]}
    cameras = {"a": camera, "b": {**camera, "size": [320, 240]}}
    sides = {"image_width": 640, "image_height": 480}
    for content in ({**cameras, "img_size": [640, 480]}, {"cameras": cameras, **sides}):
        (tmp_path / "a.json").write_text(json.dumps(content))
        first, second = read_calibration(tmp_path / "a.json").cameras
        assert (first.lens["w"], second.lens["w"]) == (640, 320)
    # One without the word may be that of the chessboard.
    (tmp_path / "a.json").write_text(json.dumps({**cameras, "size": [8, 6], "width": 8}))
    first, second = read_calibration(tmp_path / "a.json").cameras
    assert (first.lens["w"], second.lens["w"]) == (0, 320)


@pytest.mark.parametrize(
    ("said", "size"),
    [
        ({"width": 1280, "height": 720}, (1280, 720)),
        ({"w": 1280, "h": 720, "size": [8, 6]}, (1280, 720)),
        ({"size": [1280, 720]}, (1280, 720)),
        ({"size": {"width": 1280, "height": 720}}, (1280, 720)),
        ({"width": 8, "height": 6, "size": 0.025}, (0, 0)),
        ({"width": 1280}, (0, 0)),
        ({"image_size": [1280, 720], "width": 100, "height": 100}, (1280, 720)),
    ],
)
def test_plain_words_at_the_top_are_a_size_unless_they_are_small(tmp_path, said, size):
    camera = {"K": MATRIX, "R": np.eye(3).tolist(), "T": [0, 0, 1]}
    by_value = {key: {"a": value, "b": value} for key, value in camera.items()}
    for content in (by_value, {"cameras": {"a": camera, "b": camera}}, {"a": camera, "b": camera}):
        (tmp_path / "a.json").write_text(json.dumps({**content, **said}))
        cameras = read_calibration(tmp_path / "a.json").cameras
        assert [(one.lens["w"], one.lens["h"]) for one in cameras] == [size] * 2


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"imgSize": [640, float("nan")]}, "camera cam1: imgSize must be 2 finite numbers"),
        ({"image_size": [640, 480, 3]}, "camera cam1: image_size must be 2 finite numbers"),
        ({"img_size": [10**400, 480]}, "camera cam1: img_size must be 2 finite numbers"),
        ({"image_width": 640}, "the size must be two whole numbers .*640"),
        ({"image_width": -640, "image_height": 480}, "from 1 to 1000000 .* got -640 x 480"),
        ({"imgSize": [1e300, 480]}, "from 1 to 1000000 .* got 1e.300 x 480"),
    ],
)
def test_a_wrong_size_is_told(tmp_path, said, message):
    with pytest.raises(PrepareError, match=message):
        read(tmp_path / "a.json", **said)


def test_sides_are_found_among_other_values():
    values = {"imageWidth": 640, "h": "x", "height": 480, "K": MATRIX}
    assert sides_in(values) == (640, 480)
    assert list(sizes_in(values)) == ["imageWidth", "h", "height"]
    assert sides_in({"K": MATRIX}) == (0, 0)


@pytest.mark.parametrize("top", [{"resolution": 0.5}, {"resolution": "1080p"}, {"image_size": ""}])
def test_a_size_at_the_top_that_is_not_two_whole_numbers_is_none(tmp_path, top):
    path = tmp_path / "a.json"
    camera = {"K": MATRIX, "R": np.eye(3).tolist(), "t": [0, 0, 1]}
    for more, size in (({}, (0, 0)), ({"width": 640, "height": 480}, (640, 480))):
        path.write_text(json.dumps({"a": camera, **top, **more}))
        (one,) = read_calibration(path).cameras
        for lens in (one.lens, read_lenses(path)["a"]):
            assert (lens["w"], lens["h"]) == size


def test_a_size_of_null_beside_that_of_all_is_none(tmp_path):
    path = tmp_path / "a.json"
    camera = {"K": MATRIX, "R": np.eye(3).tolist(), "t": [0, 0, 1], "size": None}
    path.write_text(json.dumps({"a": camera, "size": [640, 480]}))
    (one,) = read_calibration(path).cameras
    for lens in (one.lens, read_lenses(path)["a"]):
        assert (lens["w"], lens["h"]) == (640, 480)


def test_a_size_is_one_of_two_sides_for_poses_and_for_lenses(tmp_path):
    path = tmp_path / "a.json"
    camera = {"K": MATRIX, "R": np.eye(3).tolist(), "t": [0, 0, 1], "width": 640}
    path.write_text(json.dumps({"a": camera}))
    for reader in (read_calibration, read_lenses):
        with pytest.raises(PrepareError, match="camera a: the size must be two whole numbers"):
            reader(path)
    assert size_in("a", {"width": 640, "height": 480, "size": 0.025}) == (640, 480)
    assert size_in("a", {"size": {"rows": 1, "data": [640, 480]}}) == (640, 480)
    assert size_in("a", {"size": None}) == (0, 0)
    with pytest.raises(PrepareError, match="size and image_size must not differ"):
        size_in("a", {"size": [640, 480], "image_size": [64, 48]})


@pytest.mark.parametrize(("scale", "sides"), [(2, "1280 x 960"), (0.5, "320 x 240")])
def test_a_lens_of_unknown_size_whose_middle_is_elsewhere_is_told(scale, sides):
    lens = {"w": 0, "h": 0, "fl_x": 1e3, "fl_y": 1e3, "cx": 319.5 * scale, "cy": 240.5 * scale}
    resized, finding = resized_lens(lens, "cam1", (640, 480), "poses.calibration")
    assert resized == lens | {"w": 640, "h": 480}
    text = f"says no size of its pictures, and its principal point is at {319.5 * scale:.0f} of 640"
    text += f" columns and {240.5 * scale:.0f} of 480 rows"
    assert finding.level == "warn" and text in finding.text
    assert finding.remedy.startswith(f"Was it calibrated at {sides}? Give its size: image_size=")


def test_cameras_of_unknown_size_whose_middle_is_elsewhere_are_told_once(tmp_path, capsys):
    known = Calibration(read(tmp_path / "a.json"))
    sources = [
        Source(f"cam{k}", Path(f"cam{k}.mp4"), (), np.zeros(3), ((320, 240),)) for k in (1, 2, 3)
    ]
    _, findings, _ = assign_cameras(known, sources)
    assert [one.subject for one in findings] == ["lens"] * 3
    told = "columns and 240 of 240 rows (and of 2 more cameras alike). Was it calibrated at 640 x 4"
    assert capsys.readouterr().out.count(told) == 1
    sized = Calibration(read(tmp_path / "a.json", image_size=[640, 480]))
    _, findings, _ = assign_cameras(sized, sources)
    assert len(findings) == 3 and "columns" not in capsys.readouterr().out


def test_a_lens_of_unknown_size_with_its_middle_in_the_picture_passes(capsys):
    for cx in (0.36 * 640, 320, 0.69 * 640):
        lens = {"w": 0, "h": 0, "fl_x": 1e3, "fl_y": 1e3, "cx": cx, "cy": 240.0}
        assert resized_lens(lens, "cam1", (640, 480), "poses.lens")[1] is None
    # A size that is said counts, wherever the principal point is.
    lens = {"w": 640, "h": 480, "fl_x": 1e3, "fl_y": 1e3, "cx": 600.0, "cy": 240.0}
    assert resized_lens(lens, "cam1", (640, 480), "poses.lens") == (lens, None)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("cx", [0.5, 0.0, -300.0])
def test_a_principal_point_in_shares_of_the_width_names_no_size(cx):
    lens = {"w": 0, "h": 0, "fl_x": 1.2, "fl_y": 1.2, "cx": cx, "cy": cx}
    _, finding = resized_lens(lens, "cam1", (640, 480), "poses.calibration")
    assert finding.remedy.startswith("Are all numbers in pixels?")


@pytest.mark.parametrize(
    ("cx", "cy"), [(320, 5e6), (5e6, 240), (640, 240), (320, 480), (5e6, 3.75e6), (640, 0)]
)
def test_a_principal_point_that_no_size_explains_is_asked_for_pixels(cx, cy):
    lens = {"w": 0, "h": 0, "fl_x": 1e3, "fl_y": 1e3, "cx": cx, "cy": cy}
    _, finding = resized_lens(lens, "cam1", (640, 480), "poses.calibration")
    assert finding.remedy.startswith("Are all numbers in pixels? Give its size: image_size=")
