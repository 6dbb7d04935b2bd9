"""Cameras that were covered are left out; those that see nothing but a backdrop stay."""

import dataclasses
import shutil

import numpy as np
import pytest
import toy

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.frames import read_encoded
from gaussray.dataset.images import write_image
from gaussray.reconstruct.checks.covered_cameras import without_covered_cameras


pytestmark = pytest.mark.usefixtures("known_sizes")

COVERED = toy.CAMERAS[0]
# Noise of a sensor in the dark, in linear light: sRGB-encoded it stays below what counts as detail.
NOISE = 0.0005


@pytest.fixture(scope="module")
def folder(tmp_path_factory, known_sizes):
    return toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene())


def repainted(folder, out, paint):
    """The capture with other pictures: `paint` gets view and picture, and returns the new one."""
    shutil.copytree(folder, out)
    for view in read_capture(out).views:
        picture = read_encoded(view).astype(np.float32) / 255
        write_image(view.image, paint(view, picture))
    return read_capture(out)


def names(capture, split="train"):
    return {view.camera_name for view in capture.views if view.split == split}


def test_a_camera_in_the_dark_is_left_out_with_a_warning(folder, tmp_path):
    dice = np.random.default_rng(0)

    def paint(view, picture):
        dark = np.clip(dice.normal(0.01, NOISE, picture.shape), 0, 1)
        return dark if view.camera_name == COVERED else picture + 0.2 * (picture < 0.5)

    capture = repainted(folder, tmp_path / "capture", paint)
    with pytest.warns(CaptureWarning, match=f"the pictures of {COVERED} show a single colour"):
        seen = without_covered_cameras(capture)
    assert names(capture) - names(seen) == {COVERED}
    assert len(seen.views) == sum(view.camera_name != COVERED for view in capture.views)


def test_a_camera_that_sees_something_once_stays(folder, tmp_path):
    last = max(view.time for view in read_capture(folder).views)

    def paint(view, picture):
        return picture if view.camera_name != COVERED or view.time == last else 0 * picture

    capture = repainted(folder, tmp_path / "capture", paint)
    assert without_covered_cameras(capture) is capture


def test_a_camera_that_sees_nothing_but_the_backdrop_stays(folder, tmp_path):
    """The others show a thing amid white, at whose borders nothing is."""

    def paint(view, picture):
        white = np.ones_like(picture)
        if view.camera_name != COVERED:
            white[4:-4, 4:-4] = picture[4:-4, 4:-4]
        return white

    capture = repainted(folder, tmp_path / "capture", paint)
    assert without_covered_cameras(capture) is capture


def test_pixels_that_are_masked_do_not_count(folder, tmp_path):
    capture = repainted(folder, tmp_path / "capture", lambda view, picture: picture + 0.3)
    mask = np.zeros((toy.SIZE, toy.SIZE, 3))
    mask[:4, :4] = 1
    write_image(tmp_path / "mask.png", mask)

    def paint(view, picture):
        picture[:4, :4] = 0.0
        return picture if view.camera_name == COVERED else picture + 0.3

    capture = repainted(folder, tmp_path / "masked", paint)
    alone = [
        dataclasses.replace(v, mask=tmp_path / "mask.png") if v.camera_name == COVERED else v
        for v in capture.views
    ]
    assert without_covered_cameras(capture) is capture
    with pytest.warns(CaptureWarning, match=COVERED):
        seen = without_covered_cameras(dataclasses.replace(capture, views=alone))
    assert COVERED not in names(seen)


def test_where_all_show_a_single_colour_all_stay(folder, tmp_path):
    capture = repainted(folder, tmp_path / "capture", lambda view, picture: 0 * picture)
    assert without_covered_cameras(capture) is capture
