"""Lenses that no camera has are told from those that some have."""

import pathlib
import re

import numpy as np
import pytest

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.lenses import lens_of, unusual_pixels
from gaussray.prepare.lens_check import corner_distortion, is_unreadable, lens_complaint
from gaussray.prepare.sparse_model import camera_of, pixel_rays, project_points


pytest.importorskip("pycolmap")


def lens(model, focal, **coefficients):
    """A lens of pictures of 640 x 480, whose corner is 400 pixels from the middle."""
    centre = {"cx": 320.5, "cy": 240.5}
    return {"camera_model": model, "w": 640, "h": 480, "fl_x": focal, "fl_y": focal} | (
        centre | coefficients
    )


@pytest.mark.parametrize("focal", [300.0, 240.0, 160.0])
def test_an_equidistant_fisheye_has_no_distortion_also_beyond_90_degrees(focal):
    """The corner is 76, 95 and 143 degrees off the axis."""
    assert corner_distortion(lens("OPENCV_FISHEYE", focal)) == pytest.approx(0, abs=1e-6)
    assert lens_complaint(lens("OPENCV_FISHEYE", focal)) == ("", "")


def test_the_corner_of_a_fisheye_is_shifted_by_its_polynomial():
    angle = 1.6
    share = 0.1 * angle**2 - 0.02 * angle**4
    found = corner_distortion(lens("OPENCV_FISHEYE", 400 / (angle * (1 + share)), k1=0.1, k2=-0.02))
    assert found == pytest.approx(share, abs=1e-3)


def test_a_fisheye_without_a_ray_in_the_corner_is_refused():
    """The radius grows up to an angle of 1 only, to two thirds of a focal length."""
    bent = lens("OPENCV_FISHEYE", 240.0, k1=-1 / 3)
    assert np.isnan(corner_distortion(bent))
    level, reason = lens_complaint(bent)
    assert level == "refuse" and "nan" not in reason


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV", "FULL_OPENCV"])
def test_a_pinhole_that_turns_back_before_the_corners_is_no_reason_to_refuse(model):
    """With k1 = -0.2 the largest radius is 0.86 focal lengths, that of the corner is 0.9."""
    bent = lens(model, 400 / 0.9, k1=-0.2)
    assert np.isnan(corner_distortion(bent))
    level, reason = lens_complaint(bent)
    assert level == "warn" and not is_unreadable(bent)
    assert "turns back before the corners" in reason
    assert re.search("about [12] % get no", reason)


def test_a_pinhole_that_turns_back_well_within_the_picture_is_refused():
    """With k1 = -1 the largest radius is 0.38 focal lengths: a circle of 171 pixels."""
    bent = lens("OPENCV", 400 / 0.9, k1=-1.0)
    level, reason = lens_complaint(bent)
    share = 1 - np.pi * 171**2 / (640 * 480)
    found = float(reason.split(" %")[0].split()[-1]) / 100
    assert level == "refuse" and is_unreadable(bent) and found == pytest.approx(share, abs=0.02)


def test_a_lens_whose_other_corner_turns_back_is_noticed():
    """The first corner is 0.72 focal lengths from the centre, the last one 0.88."""
    bent = lens("OPENCV", 500.0, k1=-0.2) | {"cx": 290.5, "cy": 215.5}
    assert np.isfinite(corner_distortion(bent)) and "turns back" in lens_complaint(bent)[1]


def test_a_third_without_a_direction_is_refused_if_estimated_and_read_with_a_warning():
    """One coefficient, as Anipose has it: beyond a circle of 532 pixels there is no direction."""
    anipose = {"camera_model": "OPENCV", "w": 1280, "h": 1024, "fl_x": 759.1, "fl_y": 759.1}
    anipose |= {"cx": 640.0, "cy": 512.0, "k1": -0.302}
    level, reason = lens_complaint(anipose)
    told = re.search("about (3[34]) % get no", reason)
    assert level == "refuse" and told and not is_unreadable(anipose)
    # Readers of captures take it, and say that as much is lost.
    with pytest.warns(CaptureWarning, match=f"about {told[1]} % of its pixels, at the corners"):
        lens_of(Keys(pathlib.Path("a.json"), anipose), np.float32)


@pytest.mark.parametrize("k1", [-0.22, -0.24, -0.26, -0.28])
def test_the_report_names_the_share_that_readers_name(k1):
    bent = lens("OPENCV", 400 / 0.9, k1=k1)
    level, reason = lens_complaint(bent)
    told = re.search("about ([0-9]+) % get no", reason)
    assert level == "warn" and told
    with pytest.warns(CaptureWarning, match=f"about {told[1]} % of its pixels"):
        lens_of(Keys(pathlib.Path("a.json"), bent), np.float32)


def test_pixels_that_are_not_square_are_told():
    assert unusual_pixels(1000.0, 1050.0) == ""
    assert unusual_pixels(1000.0, 1250.0) == "pixels that are 1.25 times as wide as high"
    assert lens_complaint(lens("OPENCV", 400.0) | {"fl_y": 500.0})[0] == "refuse"


def test_distortion_beyond_all_lenses_is_refused():
    level, reason = lens_complaint(lens("OPENCV", 300.0, k1=1.5))
    assert level == "refuse" and "shifts the corner by" in reason


def test_the_corner_of_a_pinhole_is_shifted_by_its_coefficient():
    """The undistorted corner is at (0.8, 0.6) focal lengths."""
    found = corner_distortion(lens("OPENCV", 400 / 0.9, k1=-0.1))
    assert found == pytest.approx(-0.1, abs=1e-3)
    assert corner_distortion(lens("OPENCV", 400.0)) == pytest.approx(0, abs=1e-6)


def test_rays_of_a_fisheye_reach_beyond_90_degrees():
    wide = lens("OPENCV_FISHEYE", 160.0, k1=0.05)
    angle = np.radians([0.0, 40.0, 89.0, 100.0])
    radius = angle * (1 + 0.05 * angle**2) * 160
    pixels = np.array([320.5, 240.5]) + radius[:, None] * np.array([0.6, -0.8])
    rays = np.column_stack([0.6 * np.sin(angle), -0.8 * np.sin(angle), np.cos(angle)])
    np.testing.assert_allclose(pixel_rays(wide, pixels), rays, atol=1e-5)
    found, depth = project_points(wide, np.eye(4)[:3], 5 * rays)
    np.testing.assert_allclose(found, pixels, atol=1e-9)
    assert depth[-1] < 0
    # Where it can, COLMAP agrees.
    theirs = np.array(camera_of(wide).cam_ray_from_img(pixels[:3]))
    np.testing.assert_allclose(theirs, rays[:3], atol=1e-5)
