"""Lenses that no camera has are told from those that some have."""

import numpy as np
import pytest

from gaussray.prepare.lens_check import corner_distortion, lens_complaint
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
    assert lens_complaint(bent)[0] == "refuse"


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
