"""Photographs with the cameras of OpenSfM and OpenDroneMap."""

import codecs
import json
import shutil

import numpy as np
import pytest
from known_photograph import (
    PIXELS,
    SHIFT,
    TO_CAMERA,
    H,
    W,
    distorted,
    fisheye,
    pixels,
    seen_points,
    sphere,
    write_picture,
)
from scipy.spatial.transform import Rotation

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats import opensfm
from gaussray.capture.formats.opensfm import read_opensfm
from gaussray.capture.open import format_of, open_capture
from gaussray.dataset.images import write_image


SIZE = {"width": W, "height": H}
SPHERE = {"width": W, "height": W // 2}
ONE = {**SIZE, "focal": 0.8}
TWO = {**SIZE, "focal_x": 0.8, "focal_y": 0.75, "c_x": 0.02, "c_y": -0.03}
BROWN = {"k1": -0.1, "k2": 0.05, "k3": -0.02, "p1": 0.003, "p2": -0.002}
ROTATION = Rotation.from_matrix(TO_CAMERA).as_rotvec().tolist()


def shot(**more):
    return {"rotation": ROTATION, "translation": SHIFT.tolist(), "camera": "c", **more}


def part(camera, names=("a.png",), **more):
    return {"cameras": {"c": camera}, "shots": {name: shot() for name in names}, **more}


def lay(folder, *parts, name="reconstruction.json"):
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(json.dumps(parts))


@pytest.fixture
def folder(tmp_path):
    for name in ("a", "b"):
        write_picture(tmp_path / "images" / f"{name}.png")
    return tmp_path


@pytest.mark.parametrize(
    ("camera", "image"),
    [
        ({"projection_type": "perspective", **ONE, "k1": -0.1, "k2": 0.05},
         lambda own: 0.8 * distorted(own, -0.1, 0.05)),
        (ONE, lambda own: 0.8 * distorted(own)),
        ({"projection_type": "simple_radial", **TWO, "k1": -0.1},
         lambda own: distorted(own, -0.1) * (0.8, 0.75) + (0.02, -0.03)),
        ({"projection_type": "radial", **TWO, "k1": -0.1, "k2": 0.05},
         lambda own: distorted(own, -0.1, 0.05) * (0.8, 0.75) + (0.02, -0.03)),
        ({"projection_type": "brown", **TWO, **BROWN},
         lambda own: distorted(own, **BROWN) * (0.8, 0.75) + (0.02, -0.03)),
        ({"projection_type": "fisheye", **ONE, "k1": 0.02, "k2": -0.01},
         lambda own: 0.8 * fisheye(own, 0.02, -0.01)),
        ({"projection_type": "fisheye_opencv", **TWO, "k1": 0.02, "k2": -0.01, "k3": 3e-3},
         lambda own: fisheye(own, 0.02, -0.01, 3e-3) * (0.8, 0.75) + (0.02, -0.03)),
        ({"projection_type": "spherical", **SPHERE}, sphere),
        ({"projection_type": "equirectangular", **SPHERE}, sphere),
    ],
)  # fmt: skip
def test_a_point_falls_where_the_documentation_puts_it(folder, camera, image):
    write_picture(folder / "images/a.png", W, camera["height"])
    lay(folder, part(camera))
    assert format_of(folder) == "opensfm"
    (view,) = open_capture(folder).views
    world, own = seen_points()
    # In units of the longer side, from the middle of the picture.
    expected = W * image(own) + (W / 2, camera["height"] / 2)
    np.testing.assert_allclose(pixels(view, world), expected, atol=PIXELS)
    assert (view.image, view.camera_name) == (folder / "images/a.png", "a")


def test_the_longer_side_of_a_portrait_is_its_height(folder):
    write_picture(folder / "images/a.png", H, W)
    lay(folder, part({"width": H, "height": W, "focal": 0.8}))
    (view,) = read_opensfm(folder).views
    np.testing.assert_allclose(view.camera.lens.focal, 0.8 * W, rtol=1e-6)


def test_the_reconstruction_with_most_pictures_is_read_and_others_are_counted(folder):
    lay(folder, part(ONE, ["c.png"]), part(ONE, ["a.png", "b.png"]), part(ONE, ["d.png"]))
    says = r"of 3 reconstructions .* most pictures \(2\) is read. Those of the others \(1, 1\)"
    with pytest.warns(CaptureWarning, match=says):
        assert [view.camera_name for view in open_capture(folder).views] == ["a", "b"]


def test_points_are_given_with_their_colours(folder):
    point = {"coordinates": [1, -2.5, 3], "color": [255.0, 0.0, 255.0]}
    lay(folder, part(ONE, points={"5": point}))
    points = open_capture(folder).points
    np.testing.assert_allclose(points.position, [[1, -2.5, 3]])
    np.testing.assert_allclose(points.color, [[1, 0, 1]])
    lay(folder, part(ONE))
    assert open_capture(folder).points is None


def test_a_project_of_opendronemap_has_the_file_in_a_folder_of_its_own(folder):
    lay(folder, part(ONE), name="opensfm/reconstruction.json")
    (view,) = open_capture(folder).views
    assert view.image == folder / "images/a.png"


def test_pictures_are_found_elsewhere_and_missing_ones_are_told(folder):
    lay(folder, part(ONE, ["a.png", "b.png"]))
    shutil.move(folder / "images", folder / "photos")
    with pytest.warns(CaptureWarning, match="2 of 2 are found if it begins with photos/"):
        assert open_capture(folder).views[1].image == folder / "photos/b.png"
    (folder / "photos/b.png").unlink()
    with pytest.warns(CaptureWarning) as told:
        assert [view.camera_name for view in open_capture(folder).views] == ["a"]
    assert any("1 of 2 frames have no picture, such as" in str(one.message) for one in told)
    shutil.rmtree(folder / "photos")
    with pytest.raises(CaptureError, match="2 of 2 frames have no picture.* Copy the pictures"):
        open_capture(folder)


def test_masks_lie_where_opensfm_has_them(folder):
    write_image(folder / "masks/a.png.png", np.full((H, W, 3), 255, np.uint8))
    lay(folder, part(ONE))
    with pytest.warns(CaptureWarning, match="1 of 1 pictures have a mask"):
        (view,) = open_capture(folder).views
    assert view.mask == folder / "masks/a.png.png"


def test_shots_may_come_after_many_cameras(folder):
    # "shots" lies on the border of what is read at once.
    for more in (200_000, *range(opensfm._AT_ONCE - 40, opensfm._AT_ONCE + 40, 3)):
        text = json.dumps([{"cameras": {"c": ONE}, "shots": {"a.png": shot()}}])
        at = text.index('"shots"')
        text = text[:at] + " " * (more - at) + text[at:]
        (folder / "reconstruction.json").write_text(text)
        assert format_of(folder) == "opensfm"
    assert len(open_capture(folder).views) == 1


def test_a_byte_order_mark_is_no_part_of_the_file(folder):
    lay(folder, part(ONE))
    text = (folder / "reconstruction.json").read_bytes()
    (folder / "reconstruction.json").write_bytes(codecs.BOM_UTF8 + text)
    assert len(open_capture(folder).views) == 1


def with_shot(**more):
    return {**part(ONE), "shots": {"a.png": shot(**more)}}


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (part({"projection_type": "dual", **ONE}), "camera of a.png: projection_type must be one "
         "of perspective, .* got 'dual'. Undistort .*opensfm undistort.* export_colmap"),
        (part({"projection_type": "fisheye624", **TWO}), "projection_type must be one of"),
        (part({"projection_type": ["brown"], **TWO}), "projection_type must be a text"),
        (part(SIZE), "camera of a.png: focal must be a number, got nothing"),
        (part({**ONE, "focal": float("nan")}), "focal must be a finite number, got nan"),
        (part({**ONE, "focal": 0}), "focal must be above 0, got 0"),
        (part({**TWO, "projection_type": "brown", "focal_y": -1}), "focal_y must be above 0"),
        (part({**ONE, "k1": "x"}), "k1 must be a finite number, got 'x'"),
        (part({"focal": 0.8, "width": W}), "height must be a whole number"),
        (with_shot(camera="d"), "shots.a.png.camera must be the name of one of the cameras"),
        (with_shot(camera=["d"]), "shots.a.png.camera must be a text"),
        (with_shot(rotation=[1, 2]), "shots.a.png.rotation must be a list of 3 finite numbers"),
        (with_shot(rotation=[1e300, 0, 0]), "shots.a.png.rotation must be that of a camera"),
        (with_shot(translation=[0, 1e300, 0]), "shots.a.png.translation must be that of a camera"),
        (with_shot(translation=None), "shots.a.png.translation must be a list of 3 finite"),
        ({**part(ONE), "shots": {"a.png": 3}}, "shots.a.png must be a block of keys, got 3"),
        ({**part(ONE), "cameras": []}, "cameras must be a block of keys"),
        (part(ONE, ()), "must have a pose, got none of 0"),
        (part(ONE, points={"5": 3}), "points.5 must be a block of keys, got 3"),
        (part(ONE, points=[1]), "points must be a block of keys"),
        (part(ONE, points={"5": {"color": [0, 0, 0]}}), "point 0: points: position must be three"),
    ],
)  # fmt: skip
def test_what_contradicts_the_format_is_refused_by_name(folder, made, says):
    lay(folder, made)
    with pytest.raises(CaptureError, match=says) as caught:
        read_opensfm(folder)
    assert str(caught.value).startswith(str(folder / "reconstruction.json"))


def test_other_files_of_the_name_are_none_of_opensfm(folder):
    for content in (
        *("[]", "[1]", '{"shots": 1}', '[{"a": 1}]'),
        *('[{"cameras": 1}]', '[{"shots": 1}]', '[{"cameras": "shots"}]'),
    ):
        (folder / "reconstruction.json").write_text(content)
        with pytest.raises(CaptureError, match="is no capture of a known format"):
            format_of(folder)
    with pytest.raises(FileNotFoundError, match="holds no reconstruction.json"):
        read_opensfm(folder)
    (folder / "reconstruction.json").write_text('[{"cameras": {}, "shots": {}, ')
    with pytest.raises(CaptureError, match="malformed JSON"):
        open_capture(folder)
