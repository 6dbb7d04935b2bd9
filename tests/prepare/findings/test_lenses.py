"""What is said about the lenses of a placement."""

import dataclasses
import re

import numpy as np
import pytest

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.findings.lenses import lens_findings
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


pytest.importorskip("pycolmap")


def lens(model, focal, **coefficients):
    """A lens of pictures of 640 x 480, whose corner is 400 pixels from the middle."""
    centre = {"cx": 320.5, "cy": 240.5}
    return {"camera_model": model, "w": 640, "h": 480, "fl_x": focal, "fl_y": focal} | (
        centre | coefficients
    )


def placed(lens):
    """One camera with a lens that is known."""
    nothing = np.zeros(0, int)
    seen = Observations(nothing, nothing, nothing, np.zeros((0, 2)), np.zeros(0))
    model = SparseModel(["a.png"], np.eye(4)[None, :3], [lens], np.zeros((0, 3)), seen)
    pictures = {"a.png": MatchingPicture("a.png", "left", 0, (400, 300))}
    return Placement(model, pictures, {}, {}, still=frozenset({"left"}), known=True)


@pytest.mark.parametrize(
    ("bend", "level"), [(0.0, "good"), (-0.2, "warn"), (-0.33, "warn"), (-1.0, "refuse")]
)
def test_a_calibration_is_refused_only_if_readers_refuse_its_lens(bend, level):
    (finding,) = lens_findings(placed(lens("OPENCV", 400 / 0.9, k1=bend)))
    assert finding.level == level
    if level != "good":
        assert finding.text.startswith("left: the calibration has distortion that turns back")
        assert finding.remedy


def test_a_given_lens_is_named_and_kept_as_a_calibration_is():
    placement = placed(lens("OPENCV", 400 / 0.9, k1=-0.2))
    model = dataclasses.replace(placement.model, focal_source="lens")
    (finding,) = lens_findings(dataclasses.replace(placement, model=model, known=False))
    assert finding.level == "warn" and finding.text.startswith("left: poses.lens has distortion")
    plain = dataclasses.replace(model, lenses=[lens("PINHOLE", 320)])
    (finding,) = lens_findings(dataclasses.replace(placement, model=plain, known=False))
    assert finding.level == "good" and finding.text.endswith("90 degrees, as poses.lens says")


def test_a_calibrated_lens_with_dark_corners_is_a_warning():
    """One coefficient, as Anipose has it: beyond a circle of 532 pixels there is no direction."""
    anipose = {"camera_model": "OPENCV", "w": 1280, "h": 1024, "fl_x": 759.1, "fl_y": 759.1}
    anipose |= {"cx": 640.0, "cy": 512.0, "k1": -0.302}
    (finding,) = lens_findings(placed(anipose))
    assert finding.level == "warn"
    assert re.search("about 3[34] % get no viewing direction", finding.text)
    assert "these pixels do not count" in finding.remedy


@pytest.mark.parametrize(
    ("source", "level", "text"),
    [
        ("pictures", "good", "horizontal fields of view of 72 degrees"),
        ("expected", "good", "as expected: the pictures do not tell"),
        ("guess", "warn", "72 degrees across the width are a guess"),
    ],
)
def test_what_tells_the_focal_length_is_said(source, level, text):
    placement = placed(lens("OPENCV", 400 / 0.9))
    model = dataclasses.replace(placement.model, focal_source=source)
    (finding,) = lens_findings(dataclasses.replace(placement, model=model, known=False))
    assert finding.level == level and text in finding.text
    assert ("poses.fov=DEGREES" in finding.remedy) == (level == "warn")
    given = dataclasses.replace(placement, model=model, known=False, fov_given=True)
    remedy = lens_findings(given)[0].remedy
    assert "poses.fov=" not in remedy and ("check poses.fov" in remedy) == (level == "warn")
    assert level != "warn" or "poses.lens=FILE" in remedy


@pytest.mark.parametrize("given", [True, False])
def test_a_rough_field_of_view_is_asked_for_where_it_is_not_given(given):
    placement = dataclasses.replace(placed(lens("PINHOLE", 20.0)), known=False, fov_given=given)
    model = dataclasses.replace(placement.model, focal_source="pictures")
    (finding,) = lens_findings(dataclasses.replace(placement, model=model))
    assert finding.level == "refuse" and ("poses.fov=70" in finding.remedy) != given
    assert ("check poses.fov" in finding.remedy) == given


def test_like_pictures_of_unlike_focal_lengths_are_doubtful_unless_they_are_calibrated():
    lenses = [lens("OPENCV", focal) for focal in (400.0, 470.0)]
    one = placed(lenses[0])
    poses = np.tile(np.eye(4)[:3], (2, 1, 1))
    model = dataclasses.replace(one.model, pictures=["a.png", "b.png"], poses=poses, lenses=lenses)
    pictures = one.pictures | {"b.png": MatchingPicture("b.png", "right", 0, (640, 480))}
    both = dataclasses.replace(one, model=model, pictures=pictures)
    assert [finding.level for finding in lens_findings(both)] == ["good"]
    (finding,) = lens_findings(dataclasses.replace(both, known=False))
    assert finding.level == "warn" and "left (400 pixels) and right (470)" in finding.text
    model.lenses[1]["fl_x"] = model.lenses[1]["fl_y"] = 450.0
    (finding,) = lens_findings(dataclasses.replace(both, known=False))
    assert finding.level == "good" and finding.text.endswith("of 71 to 77 degrees")


def test_like_lenses_that_lose_other_shares_are_told_of_together():
    """With k1 = -0.22 and -0.28 distortion turns back at 0.82 and 0.73 focal lengths."""
    first, second = (lens("OPENCV", 400 / 0.9, k1=k1) for k1 in (-0.22, -0.28))
    one = placed(first)
    poses = np.repeat(one.model.poses, 2, axis=0)
    model = dataclasses.replace(
        one.model, pictures=["a.png", "b.png"], poses=poses, lenses=[first, second]
    )
    pictures = one.pictures | {"b.png": MatchingPicture("b.png", "right", 0, (400, 300))}
    (finding,) = lens_findings(dataclasses.replace(one, model=model, pictures=pictures))
    assert finding.text.startswith("left, right: the calibration has distortion that turns back")
    assert re.search("about [0-9]+ to [0-9]+ % get no viewing direction", finding.text)
