"""Cameras with their values in blocks and under keys of their own, in JSON and in YAML."""

import json

import numpy as np
import pytest
import yaml
from quads import arc

from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


POSES = arc(3)
NAMES = ("cam0", "cam1", "cam2")
MATRIX = [[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]]
FOUR = [-0.05, 0.02, 0.001, -0.002]
COEFFICIENTS = ("k1", "k2", "p1", "p2")
FOCAL = {"fx": 500.0, "fy": 505.0, "cx": 310.25, "cy": 242.5}
APART = {**FOCAL, **dict(zip(COEFFICIENTS, FOUR, strict=True))}
# Numbers keep all their digits in these files.
CLOSE = 1e-9


def storage(values):
    """A matrix as OpenCV's FileStorage writes it to JSON."""
    array = np.atleast_2d(values)
    rows, cols = array.shape
    return {
        "type_id": "opencv-matrix",
        **{"rows": rows, "cols": cols, "dt": "d", "data": array.ravel().tolist()},
    }


def whole(pose):
    return np.vstack([pose, [0, 0, 0, 1]]).tolist()


def inverse(pose):
    return np.linalg.inv(whole(pose)).tolist()


SIZE = {"width": 640, "height": 480}
# The values of a camera with a pose, as public files have them.
LAYOUTS = {
    "separate numbers": lambda p: {
        "intrinsics": {**APART, **SIZE},
        "extrinsics": {"R": p[:, :3].tolist(), "t": p[:, 3].tolist()},
    },
    "matrices": lambda p: {
        "intrinsics": {"camera_matrix": MATRIX, "dist_coeffs": FOUR, "image_size": [640, 480]},
        "extrinsics": {"rotation": p[:, :3].tolist(), "translation": p[:, 3:].tolist()},
    },
    "a matrix each": lambda p: {
        "intrinsics": {"matrix": MATRIX, "distortion": FOUR},
        "extrinsics": {"matrix": whole(p)},
        "resolution": [640, 480],
    },
    "4 x 4 itself": lambda p: {
        "intrinsics": {**FOCAL, "distortion": FOUR, **SIZE},
        "extrinsics": whole(p),
    },
    "camera to world": lambda p: {
        "intrinsic_parameters": {"K": MATRIX, "dist": FOUR, "size": [640, 480]},
        "extrinsic_parameters": {"camera_to_world": inverse(p)},
    },
    "said camera to world": lambda p: {
        **{"intrinsics": {"K": MATRIX, "dist": FOUR, "size": [640, 480]}},
        "extrinsics": {
            **{"R": p[:, :3].T.tolist(), "t": (-p[:, :3].T @ p[:, 3]).tolist()},
            "convention": "camera-to-world",
        },
    },
    "no blocks": lambda p: {**APART, **SIZE, "R": p[:, :3].tolist(), "t": p[:, 3].tolist()},
    "a block of distortion": lambda p: {
        **{"fx": 500, "fy": 505.0, "ppx": 310.25, "ppy": 242.5},
        "distortion": {"model": "plumb_bob", **dict(zip(COEFFICIENTS, FOUR, strict=True))},
        **{"image_width": 640, "image_height": 480, "w2c": whole(p)},
    },
    "four numbers": lambda p: {
        **{"intrinsics": [500.0, 505.0, 310.25, 242.5], "dist": FOUR, "size": [640, 480]},
        "extrinsics": {"R": p[:, :3].tolist(), "T": p[:, 3].tolist()},
    },
    "OpenCV's JSON": lambda p: {
        **{"camera_matrix": storage(MATRIX), "distortion_coefficients": storage(FOUR)},
        **{"image_width": 640, "image_height": 480},
        **{"R": storage(p[:, :3]), "T": storage(p[:, 3:])},
    },
}


def write(path, content):
    text = json.dumps(content) if path.suffix == ".json" else yaml.safe_dump(content)
    path.write_text(text)
    return path


def check(cameras, names=NAMES):
    assert [one.name for one in cameras] == list(names)
    for one, pose in zip(cameras, POSES, strict=True):
        assert one.pose == pytest.approx(pose, abs=CLOSE)
        lens = one.lens
        found = [lens[key] for key in ("fl_x", "fl_y", "cx", "cy", *COEFFICIENTS)]
        assert found == pytest.approx([500, 505, 310.75, 243.0, *FOUR], abs=CLOSE)
        assert (lens["camera_model"], lens["w"], lens["h"]) == ("OPENCV", 640, 480)


@pytest.mark.parametrize("suffix", [".json", ".yaml", ".yml"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_cameras(tmp_path, layout, suffix):
    cameras = {name: LAYOUTS[layout](pose) for name, pose in zip(NAMES, POSES, strict=True)}
    path = tmp_path / f"rig{suffix}"
    listed = [{"camera_id": name, **one} for name, one in cameras.items()]
    for content in (cameras, {"cameras": cameras}, {"cameras": listed}, {"unit": "m", **cameras}):
        check(read_calibration(write(path, content)).cameras)
        assert read_lenses(path) == {c.name: c.lens for c in read_calibration(path).cameras}
    if suffix == ".json":
        check(read_calibration(write(path, listed)).cameras)


@pytest.mark.parametrize("suffix", [".json", ".yaml"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_may_be_a_file_for_each_camera(tmp_path, layout, suffix):
    for name, pose in zip(NAMES, POSES, strict=True):
        path = write(tmp_path / f"{name}{suffix}", LAYOUTS[layout](pose))
    check(read_calibration(tmp_path).cameras)
    with pytest.raises(PrepareError, match=f"got one. .* poses.calibration={tmp_path}"):
        read_calibration(path)


def test_the_way_is_told(tmp_path, capsys):
    for layout, told in (
        ("separate numbers", "R and t are taken as OpenCV's, from world to camera."),
        ("camera to world", "camera_to_world is taken as OpenCV's, from camera to world, and inv"),
        ("said camera to world", "R and t are taken as OpenCV's, from camera to world, and invert"),
    ):
        content = {name: LAYOUTS[layout](pose) for name, pose in zip(NAMES, POSES, strict=True)}
        read_calibration(write(tmp_path / "a.json", content))
        assert told in capsys.readouterr().out
    content = {"convention": "cam2world", **content}
    read_calibration(write(tmp_path / "a.json", content))
    assert "camera to world" in capsys.readouterr().out


def test_values_by_camera_may_be_blocks(tmp_path):
    layout = LAYOUTS["a matrix each"]
    cameras = {name: layout(pose) for name, pose in zip("lrd", POSES, strict=True)}
    content = {
        key: {name: one[key] for name, one in cameras.items()}
        for key in ("intrinsics", "extrinsics", "resolution")
    }
    check(read_calibration(write(tmp_path / "a.json", content)).cameras, "lrd")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"intrinsics": {"fx": 1.0, "fy": 1.0}},
            "fx, fy, cx and cy as numbers, got no cx, cy",
        ),
        ({"fx": 400.0}, "camera a: fx must be there once, got [45]00.0 and"),
        ({"K": (np.array(MATRIX) + np.diag([1.1, 0, 0])).tolist()}, "must not differ from the mat"),
        ({"K": np.eye(3).tolist()}, "fx, fy, cx and cy must not differ from the matrix"),
        (
            {"intrinsics": {**APART, "skew": 4.0}},
            "must have no skew, got 4 pixels .* 500.* if 0.79 pixels for each 100",
        ),
        ({"intrinsics": {**APART, "model": "omni"}}, "must be a pinhole .* got omni"),
        ({"extrinsics": {"R": [1, 0, 0, 0], "t": [0, 0, 0]}}, "a has no R .3 or 9 numbers"),
        ({"extrinsics": {"matrix": whole(POSES[0])[:2]}}, "a has no R .3 or 9 numbers"),
        ({"convention": "OpenGL camera to world"}, "must have OpenCV's axes .* got convention: Op"),
        ({"extrinsics": np.transpose(whole(POSES[0])).tolist()}, "extrinsics of .* transposed"),
    ],
)
def test_a_wrong_block_is_named(tmp_path, changes, message):
    one = LAYOUTS["separate numbers"](POSES[0]) | changes
    for suffix in (".json", ".yaml"):
        with pytest.raises(PrepareError, match=message):
            read_calibration(write(tmp_path / f"rig{suffix}", {"cameras": {"a": one, "b": one}}))


@pytest.mark.parametrize("suffix", [".json", ".yaml"])
@pytest.mark.parametrize("plain", [False, True])
def test_a_stereo_calibration_is_read(tmp_path, suffix, plain):
    pose = POSES[1]
    values = {"K1": MATRIX, "D1": FOUR, "K2": MATRIX, "D2": FOUR, "R": pose[:, :3], "T": pose[:, 3]}
    values = {
        key: np.array(value).tolist() if plain else storage(value) for key, value in values.items()
    }
    calibration = read_calibration(write(tmp_path / f"stereo{suffix}", values))
    assert calibration.is_pair
    assert calibration.cameras[1].pose == pytest.approx(pose, abs=CLOSE)
    assert calibration.cameras[0].lens["fl_y"] == 505


def test_yaml_without_cameras_is_told_as_kalibrs(tmp_path):
    with pytest.raises(PrepareError, match="as Kalibr does"):
        read_calibration(write(tmp_path / "a.yaml", {"b": {"c": 1}}))
    lens = {"K": MATRIX, "dist": FOUR}
    with pytest.raises(PrepareError, match="must have a camera with a pose, got none: camera cam0"):
        read_calibration(write(tmp_path / "a.yaml", {"cam0": lens, "cam1": lens}))


LENSES = {
    "K": lambda f: {"K": [[f, 0, 320], [0, f, 240], [0, 0, 1]]},
    "K and dist": lambda f: {"K": [[f, 0, 320], [0, f, 240], [0, 0, 1]], "dist": FOUR},
    "fx": lambda f: {"fx": f, "fy": f, "cx": 320, "cy": 240},
    "a block": lambda f: {"intrinsics": {"fx": f, "fy": f, "cx": 320, "cy": 240}},
    "P": lambda f: {"P": [[f, 0, 320, f], [0, f, 240, 2 * f], [0, 0, 1, 0.1]]},
}


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("names", ["abcd", "KRt", "KRTD", "dK", ["dist", "D", "d"], ["k1", "k2"]])
def test_cameras_may_be_called_as_values_are(tmp_path, names, lens):
    wanted = {name: 500.0 + k for k, name in enumerate(names)}
    content = {name: LENSES[lens](focal) for name, focal in wanted.items()}
    for whole_file in (content, {"cameras": content}):
        lenses = read_lenses(write(tmp_path / "a.json", whole_file))
        assert {name: one["fl_x"] for name, one in lenses.items()} == pytest.approx(wanted)
    pose = {} if lens == "P" else {"R": np.eye(3).tolist(), "t": [0, 0, 1]}
    content = {name: one | pose for name, one in content.items()}
    cameras = read_calibration(write(tmp_path / "a.json", content)).cameras
    assert {one.name: one.lens["fl_x"] for one in cameras} == pytest.approx(wanted)


def test_the_matrix_is_taken_where_focal_lengths_beside_it_are_rounded(tmp_path, capsys):
    one = {"K": [[500.3, 0, 310.25], [0, 505.4, 242.5], [0, 0, 1]], "R": np.eye(3).tolist()}
    one |= {"t": [0, 0, 1]}
    for focal, told in (
        ({"fx": 500, "fy": 505, "cx": 310, "cy": 242}, True),
        ({"fx": 500.3, "fy": 505.4, "cx": 310.25, "cy": 242.5}, False),
    ):
        path = write(tmp_path / "a.json", {"a": one | focal, "b": {**one, "t": [0, 1, 1]}})
        assert {camera.lens["fl_x"] for camera in read_calibration(path).cameras} == {500.3}
        assert ("fx, fy, cx" in capsys.readouterr().out) == told
        read_lenses(path)
        assert ("the matrix and the list are taken" in capsys.readouterr().out) == told
