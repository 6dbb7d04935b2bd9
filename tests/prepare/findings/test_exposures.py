"""What is said about the brightness of the cameras."""

import numpy as np

from gaussray.prepare.exposure import LEAST_SHARED
from gaussray.prepare.findings.exposures import exposure_findings, picture_exposure_findings


NOT_COMPARED = (
    f"not compared: fewer than {LEAST_SHARED} shared points that are neither black nor clipped)"
)


def found(gains, **clipped):
    """The findings about cameras of whose pictures such shares are clipped."""
    return exposure_findings(gains, dict.fromkeys(gains, 0.0) | clipped)


def gains(count=LEAST_SHARED, **stops):
    return {name: (np.array([0, stop, 0]), count) for name, stop in stops.items()}


def test_the_channel_that_differs_most_decides():
    (good,) = found(gains(a=0.14, b=-0.1))
    assert good.level == "good" and good.text == "cameras agree to 0.14 stops"
    (doubt,) = found(gains(a=0.1, b=-0.16))
    assert doubt.level == "warn" and doubt.text.startswith("b differs")
    assert "0.16 stops" in doubt.text


def test_cameras_that_share_few_points_are_not_compared():
    few = gains(LEAST_SHARED - 1, b=0.0, c=0.0)
    (doubt,) = found(gains(a=0.0) | few)
    assert doubt.level == "warn" and "too few shared points" in doubt.text
    assert found(gains(a=0.0)) == []
    (good,) = found(gains(a=0.0, d=0.0) | few)
    assert good.level == "good" and good.text.endswith(f"agree to 0.00 stops (b, c {NOT_COMPARED}")


def test_a_camera_that_is_nearly_black_is_told_and_not_said_to_agree():
    dark = {"c": (np.full(3, -4.2), 3)}
    black, good = found(gains(a=0.0, b=0.1) | dark)
    assert black.level == "warn" and black.text.startswith("c is too dark to compare")
    assert "about 4 stops darker" in black.text and black.remedy
    assert good.text == f"cameras agree to 0.10 stops (c {NOT_COMPARED}"
    _, doubt = found(gains(a=0.0, b=0.2) | dark)
    assert doubt.text.endswith(f"(c {NOT_COMPARED}")


def test_a_camera_whose_picture_is_clipped_is_told_unless_those_of_the_others_are():
    some = gains(a=0.0, b=0.1) | gains(0, c=0.0)
    bright, good = found(some, a=0.1, b=0.1, c=0.36)
    assert bright.level == "warn" and bright.remedy
    assert bright.text.startswith("c has too few shared points to compare, and 36 % of its picture")
    assert good.text.endswith(f"(c {NOT_COMPARED}")
    assert len(found(some, a=0.1, b=0.1, c=0.34)) == 1
    # Without any to compare with, white may be a wall.
    assert len(found(gains(0, a=0.0, b=0.0), a=0.4, b=0.4)) == 1
    # What can be compared is not too bright.
    assert len(found(gains(a=0.0, b=0.1), b=0.9)) == 1


def of_pictures(gains, photographs=True):
    gains = {name: np.array(stops) for name, stops in gains.items()}
    return picture_exposure_findings(gains, photographs=photographs)


def test_pictures_of_a_camera_on_its_way_are_compared_channel_by_channel():
    (good,) = of_pictures({"a": [0.1, 0, 0], "b": [-0.1, 0, 0], "c": [np.nan] * 3})
    assert good.level == "good" and "mean of their camera to 0.10 stops" in good.text
    assert good.text.endswith("; 1 of 3 share too few points to be compared")
    # A white balance that changes: brighter in red is darker in blue.
    (doubt,) = of_pictures({"a": [0.2, 0, -0.3], "b": [0, 0, 0.1], "c": [-0.2, 0, 0.2]})
    assert doubt.level == "warn" and "up to 0.30 stops of blue (a is the darkest, c" in doubt.text
    assert "share too few" not in doubt.text and "fit.refine=[exposure]" in doubt.remedy
    # A video is one camera, which has one gain.
    (doubt,) = of_pictures({"a": [0.2, 0, 0], "b": [-0.2, 0, 0]}, photographs=False)
    assert "fit.refine" not in doubt.remedy and doubt.remedy.startswith("Lock exposure")
    assert of_pictures({}) == [] and of_pictures({"a": [0.0] * 3, "b": [np.nan] * 3}) == []


def test_grey_pictures_differ_in_no_channel():
    (doubt,) = of_pictures({"a": [0.3] * 3, "b": [-0.3] * 3})
    assert "by up to 0.30 stops (b is the darkest, a the brightest)" in doubt.text
    (doubt,) = of_pictures({"a": [0.3, 0.3, 0.31], "b": [-0.3] * 3})
    assert "0.31 stops of blue" in doubt.text
