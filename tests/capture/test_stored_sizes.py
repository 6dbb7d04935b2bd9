"""Pictures that were resized without their manifest: cameras are resized with them."""

import json
import warnings

import jax
import numpy as np
import pytest

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.frames import read_encoded
from gaussray.capture.open import open_capture
from gaussray.capture.picture_file import check_size
from gaussray.capture.selection import Selection
from gaussray.capture.stored_sizes import at_stored_sizes
from gaussray.dataset.images import write_image


W, H = 48, 33
# Single precision, in pixels.
PIXELS = 1e-4
LENS = {"camera_model": "OPENCV", "fl_x": 40, "fl_y": 42, "cx": 22, "cy": 17, "k1": 0.05}


def lay(folder, *sizes):
    """A capture of one camera whose pictures have other sizes than its manifest says; one size is
    that of two pictures."""
    sizes = sizes if len(sizes) > 1 else 2 * sizes
    pose = np.eye(4).tolist()
    frames = [
        {"file_path": f"{k}.png", "transform_matrix": pose, "time": k / len(sizes), "camera": "a"}
        for k in range(len(sizes))
    ]
    rolling = {"shutter": {"row_offset": -0.1, "row_step": 0.01}}
    document = {"w": W, "h": H, **LENS, **rolling, "split": "train", "frames": frames}
    folder.mkdir(exist_ok=True)
    for frame, size in zip(frames, sizes, strict=True):
        write_image(folder / frame["file_path"], np.full((size[1], size[0], 3), 90, np.uint8))
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


@pytest.mark.parametrize("size", [(24, 17), (24, 16), (96, 66)])
def test_cameras_follow_pictures_that_were_resized_as_a_whole(tmp_path, size):
    with pytest.warns(CaptureWarning, match=f"pictures are {size[0]} x {size[1]} where") as told:
        views = open_capture(lay(tmp_path / "small", size)).views
    assert len(told) == 1 and read_encoded(views[0]).shape == (size[1], size[0], 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        whole = open_capture(lay(tmp_path / "whole", (W, H))).views[0]
    # A point of the scene stays at the same place of the picture.
    point = jax.numpy.array([0.2, -0.1, 1.0])
    expected = np.asarray(whole.camera.lens.project(point)) * np.array(size) / (W, H)
    found = views[0].camera.lens.project(point)
    np.testing.assert_allclose(found, expected, atol=PIXELS)
    # The readout takes as long, in fewer rows.
    lasts = [float(v.camera.shutter.row_step) * v.height for v in (views[0], whole)]
    np.testing.assert_allclose(*lasts, rtol=1e-6)
    assert views[0].camera.lens is views[1].camera.lens


def test_the_first_picture_that_is_there_tells(tmp_path):
    (lay(tmp_path, (24, 17)) / "0.png").unlink()
    with pytest.warns(CaptureWarning) as told:
        (view,) = open_capture(tmp_path).views
    assert any("pictures are 24 x 17 where" in str(one.message) for one in told)
    assert read_encoded(view).shape == (17, 24, 3)


@pytest.mark.parametrize("bad", [None, b"no picture"])
def test_what_cannot_be_read_has_the_one_size_of_its_neighbours(tmp_path, bad):
    picture = lay(tmp_path, (24, 17), (24, 17), (24, 17)) / "1.png"
    picture.unlink()
    if bad is not None:
        picture.write_bytes(bad)
    with pytest.warns(CaptureWarning, match="pictures are 24 x 17 where"):
        views = at_stored_sizes(read_capture(tmp_path)).views
    assert [(view.width, view.height) for view in views] == 3 * [(24, 17)]
    assert len({id(view.camera.lens) for view in views}) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kept = open_capture(tmp_path).views
    # What is absent is left out later, and what cannot be read is not.
    assert [view.image.name for view in kept] == [f"{k}.png" for k in range(3) if bad or k != 1]
    assert {(view.width, view.height) for view in kept} == {(24, 17)}


def test_among_several_sizes_what_cannot_be_read_has_the_size_that_the_file_says(tmp_path):
    (lay(tmp_path, (24, 17), (W, H), (24, 17)) / "2.png").write_bytes(b"no picture")
    with pytest.warns(CaptureWarning, match="1 of 2 pictures are 24 x 17 where"):
        views = open_capture(tmp_path).views
    assert [(view.width, view.height) for view in views] == [(24, 17), (W, H), (W, H)]


@pytest.mark.filterwarnings("ignore:.*the pictures are 24 x 17")
def test_they_may_be_scaled_again(tmp_path):
    (view, _) = open_capture(lay(tmp_path, (24, 17)), selection=Selection(scale=0.5)).views
    assert (view.width, view.height) == (12, 8) and read_encoded(view).shape == (8, 12, 3)


@pytest.mark.parametrize("size", [(33, 48), (40, 17), (48, 30)])
def test_pictures_of_another_shape_are_an_error(tmp_path, size):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (view, _) = open_capture(lay(tmp_path, size)).views
    with pytest.raises(
        CaptureError, match=f"must be w x h = {W} x {H} .*, got {size[0]} x {size[1]}.*with fl_x"
    ):
        read_encoded(view)


def test_of_a_slightly_different_shape_the_cameras_may_be_those_of_undistorted_copies():
    with pytest.raises(CaptureError, match="1430 x 1071 .*, got 1440 x 1080.*undistorted copy"):
        check_size("a.jpg", (1440, 1080), 1430, 1071)


def test_pictures_of_several_sizes_have_cameras_of_their_own(tmp_path):
    sizes = [(24, 17), (W, H), (96, 66), (24, 16)]
    with pytest.warns(CaptureWarning) as told:
        views = open_capture(lay(tmp_path, *sizes)).views
    (text,) = [str(one.message) for one in told]
    assert "3 of 4 pictures are of 3 sizes from 24 x 16 to 96 x 66 where the cameras say" in text
    point = jax.numpy.array([0.2, -0.1, 1.0])
    place = np.asarray(views[1].camera.lens.project(point)) / (W, H)
    for view, size in zip(views, sizes, strict=True):
        assert read_encoded(view).shape == (size[1], size[0], 3)
        found = np.asarray(view.camera.lens.project(point))
        np.testing.assert_allclose(found, place * np.array(size), atol=PIXELS)


def test_of_several_sizes_those_of_another_shape_are_named_with_what_the_file_says(tmp_path):
    folder = lay(tmp_path, (24, 17), (40, 17), (W, H), (24, 17), (H, W))
    with pytest.warns(CaptureWarning) as told:
        views = open_capture(folder, selection=Selection(scale=0.5)).views
    (text,) = [str(one.message) for one in told]
    assert "2 of 5 pictures are 24 x 17 where the cameras say 48 x 33; lens and shutter" in text
    # A lying picture may be turned by its orientation: its reader decides.
    assert "1 other has another aspect ratio, such as 1.png with 40 x 17, and cannot" in text
    shapes = [read_encoded(views[k]).shape for k in (0, 2, 3)]
    assert shapes == [(8, 12, 3), (16, 24, 3), (8, 12, 3)]
    for k, size in (1, (40, 17)), (4, (H, W)):
        with pytest.raises(
            CaptureError,
            match=rf"{k}\.png: .* {W} x {H} as its camera says, got {size[0]} x {size[1]}",
        ):
            read_encoded(views[k])
