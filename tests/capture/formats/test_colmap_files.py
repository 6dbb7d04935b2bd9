"""COLMAP's files, binary and text: what they say, and what a hostile one cannot do."""

import struct
import tracemalloc

import colmaps
import numpy as np
import pytest

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.colmap_files import (
    COLMAP_MODELS,
    model_folder,
    read_colmap_model,
)
from gaussray.color import srgb_decode


CAMERAS = {
    1: ("PINHOLE", 40, 30, (50.0, 51.0, 20.5, 14.5)),
    7: ("SIMPLE_PINHOLE", 8, 6, (9.0, 4, 3)),
}
IMAGES = [
    ("b 2.png", (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3), 7),
    ("a/1.png", (0.5, -0.5, 0.5, 0.5), (-1.0, 2.0, 1e-3), 1),
]
POINTS = [((0.1, 0.2, 0.3), (255, 0, 128), 2), ((-1.0, 1e3, 4.0), (1, 2, 3), 0)]


@pytest.fixture(params=["bin", "txt"])
def folder(request, tmp_path):
    """The same model in either form."""
    return colmaps.lay(tmp_path / "sparse/0", CAMERAS, IMAGES, POINTS, request.param)


def test_both_forms_say_the_same(folder):
    model = read_colmap_model(folder)
    first, second = model.images
    assert (first.name, first.quat, first.translation, first.camera) == IMAGES[1]
    assert (second.name, second.quat, second.translation, second.camera) == IMAGES[0]
    shared = {"camera_model": "PINHOLE", "w": 40, "h": 30}
    assert model.cameras[1] == {**shared, "fl_x": 50, "fl_y": 51, "cx": 20.5, "cy": 14.5}
    shared = {"camera_model": "SIMPLE_PINHOLE", "w": 8, "h": 6}
    assert model.cameras[7] == {**shared, "fl_x": 9, "fl_y": 9, "cx": 4, "cy": 3}
    np.testing.assert_array_equal(model.points.position, np.float32([p for p, *_ in POINTS]))
    expected = srgb_decode(np.array([color for _, color, _ in POINTS]) / 255)
    np.testing.assert_allclose(model.points.color, expected, rtol=1e-6)


@pytest.mark.parametrize("form", ["bin", "txt"])
@pytest.mark.parametrize("number", COLMAP_MODELS)
def test_parameters_of_every_model_go_by_their_names(tmp_path, form, number):
    name, names = COLMAP_MODELS[number]
    values = tuple(float(k + 1) for k in range(len(names)))
    colmaps.lay(tmp_path, {1: (name, 4, 3, values)}, [("a.png", *IMAGES[0][1:3], 1)], [], form)
    camera = read_colmap_model(tmp_path).cameras[1]
    expected = dict(zip(names, values, strict=True))
    if "f" in expected:
        assert camera["fl_x"] == camera["fl_y"] == expected.pop("f")
    assert {key: camera[key] for key in expected} == expected
    assert camera["camera_model"] == ("OPENCV_FISHEYE" if "RADIAL_FISHEYE" in name else name)


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "colmap/sparse/0", "."])
@pytest.mark.parametrize("form", ["bin", "txt"])
def test_the_folder_is_found_where_tools_put_it(tmp_path, place, form):
    assert model_folder(tmp_path) is None
    colmaps.lay(tmp_path / place, CAMERAS, IMAGES, [], form)
    assert model_folder(tmp_path) == tmp_path / place
    (tmp_path / place / f"images.{form}").unlink()
    assert model_folder(tmp_path) is None


def test_points_are_optional(folder):
    for path in folder.glob("points3D.*"):
        path.unlink()
    assert read_colmap_model(folder).points is None


def test_without_images_there_is_no_capture(tmp_path):
    colmaps.lay(tmp_path, CAMERAS, [], POINTS, "bin")
    with pytest.raises(CaptureError, match="images.bin: the model must have at least one image"):
        read_colmap_model(tmp_path)


def test_a_camera_that_there_is_not(tmp_path):
    for form in ("bin", "txt"):
        colmaps.lay(tmp_path / form, CAMERAS, [(*IMAGES[0][:3], 5)], [], form)
        with pytest.raises(CaptureError, match=f"the camera of b 2.png .*cameras.{form}, got .* 5"):
            read_colmap_model(tmp_path / form)


@pytest.mark.parametrize("model", ["FOV", "RAD_TAN_THIN_PRISM_FISHEYE"])
def test_a_model_that_no_lens_of_ours_is(tmp_path, model):
    numbers = {"FOV": 7, "RAD_TAN_THIN_PRISM_FISHEYE": 11}
    said = {"bin": numbers[model], "txt": model}
    for form in ("bin", "txt"):
        cameras = {3: (model, 4, 3, (1.0,) * 5)}
        colmaps.lay(tmp_path / form, cameras, IMAGES, [], form, numbers)
        with pytest.raises(CaptureError) as caught:
            read_colmap_model(tmp_path / form)
        text = str(caught.value)
        assert f"cameras.{form}: the model of camera 3 must be one of SIMPLE_PINHOLE" in text
        assert f"got {said[form]}. Run `colmap image_undistorter`" in text


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_a_binary_file_cut_anywhere_is_refused(tmp_path, name):
    path = colmaps.lay(tmp_path, CAMERAS, IMAGES, POINTS, "bin") / f"{name}.bin"
    data = path.read_bytes()
    for end in range(len(data)):
        path.write_bytes(data[:end])
        with pytest.raises(CaptureError, match=f"{name}.bin: the file must go on .* truncated"):
            read_colmap_model(tmp_path)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_a_count_beyond_the_file_is_an_error_and_takes_no_memory(tmp_path, name):
    path = colmaps.lay(tmp_path, CAMERAS, IMAGES, POINTS, "bin") / f"{name}.bin"
    data = path.read_bytes()
    rows = 2 if name != "cameras" else len(CAMERAS)
    assert data[:8] == struct.pack("<Q", rows)
    huge = [struct.pack("<Q", 2**63 + 1) + data[8:]]
    if name != "cameras":
        # The last entry's own list: points of an image, or images of a point.
        huge.append(data[:-8] + struct.pack("<Q", 2**62))
    for content in huge:
        path.write_bytes(content)
        tracemalloc.start()
        with pytest.raises(CaptureError, match="truncated"):
            read_colmap_model(tmp_path)
        assert tracemalloc.get_traced_memory()[1] < 2**20
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("name", "line", "says"),
    [
        ("cameras", "1 PINHOLE 40 30 50 51 20", "PINHOLE has 4 parameters"),
        ("cameras", "1 PINHOLE 40", "PINHOLE has 4 parameters"),
        ("cameras", "1", "got '1'"),
        ("cameras", "one PINHOLE 40 30 50 51 20 14", "invalid literal"),
        ("images", "1 1 0 0 0 0 0 0 1", "nine numbers and a name"),
        ("images", "1 x 0 0 0 0 0 0 1 a.png", "could not convert"),
        ("points3D", "1 0 0", "at least eight numbers"),
        ("points3D", "1 0 0 zero 1 2 3 0.5", "could not convert"),
    ],
)
def test_a_line_that_is_not_colmaps_is_named(tmp_path, name, line, says):
    path = colmaps.lay(tmp_path, CAMERAS, IMAGES, POINTS, "txt") / f"{name}.txt"
    path.write_text(f"# a comment\n\n{line}\n")
    with pytest.raises(CaptureError, match=f"{name}.txt: line 3 must be as COLMAP.*{says}"):
        read_colmap_model(tmp_path)


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_points_that_are_not_finite(tmp_path, form):
    points = [((np.nan, 0, 0), (1, 2, 3), 0)]
    colmaps.lay(tmp_path, CAMERAS, IMAGES, points, form)
    with pytest.raises(CaptureError, match=f"points3D.{form}: points must be finite, got nan"):
        read_colmap_model(tmp_path)
