"""What is said about the brightness of the cameras."""

import numpy as np

from gaussray.prepare.exposure import LEAST_SHARED
from gaussray.prepare.findings.exposures import exposure_findings


def gains(count=LEAST_SHARED, **stops):
    return {name: (np.array([0, stop, 0]), count) for name, stop in stops.items()}


def test_the_channel_that_differs_most_decides():
    (good,) = exposure_findings(gains(a=0.14, b=-0.1))
    assert good.level == "good" and good.text == "cameras agree to 0.14 stops"
    (doubt,) = exposure_findings(gains(a=0.1, b=-0.16))
    assert doubt.level == "warn" and doubt.text.startswith("b differs")
    assert "0.16 stops" in doubt.text


def test_cameras_that_share_few_points_are_not_compared():
    few = gains(LEAST_SHARED - 1, b=0.0, c=0.0)
    (doubt,) = exposure_findings(gains(a=0.0) | few)
    assert doubt.level == "warn" and "too few shared points" in doubt.text
    assert exposure_findings(gains(a=0.0)) == []
    (good,) = exposure_findings(gains(a=0.0, d=0.0) | few)
    assert good.level == "good" and good.text.endswith("agree to 0.00 stops (b, c not compared)")


def test_a_camera_that_is_nearly_black_is_told_and_not_said_to_agree():
    dark = {"c": (np.full(3, -4.2), 3)}
    black, good = exposure_findings(gains(a=0.0, b=0.1) | dark)
    assert black.level == "warn" and black.text.startswith("c is too dark to compare")
    assert "about 4 stops darker" in black.text and black.remedy
    assert good.text == "cameras agree to 0.10 stops (c not compared)"
    _, doubt = exposure_findings(gains(a=0.0, b=0.2) | dark)
    assert doubt.text.endswith("(c not compared)")
