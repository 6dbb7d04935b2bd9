"""What is said about the points and where they are seen."""

import dataclasses

import numpy as np
import pytest

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.findings.points import OBSERVATIONS, point_findings
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


def placed(counts, error, width=1000, known=False):
    """Cameras with so many observations each, all so many pixels off."""
    picture = np.repeat(np.arange(len(counts)), counts)
    point = np.concatenate([np.arange(count) for count in counts])
    errors = np.full(len(point), float(error))
    seen = Observations(point, picture, point, np.zeros((len(point), 2)), errors)
    files = [f"{k}.png" for k in range(len(counts))]
    lenses = [{"w": width}] * len(counts)
    poses = np.zeros((len(counts), 3, 4))
    model = SparseModel(files, poses, lenses, np.zeros((max(counts), 3)), seen)
    pictures = {f: MatchingPicture(f, f"camera{k}", 0, (4, 3)) for k, f in enumerate(files)}
    still = frozenset(picture.camera for picture in pictures.values())
    return Placement(model, pictures, {}, {}, still=still, known=known)


@pytest.mark.parametrize("width", [1000, 4000])
def test_reprojection_errors_count_against_the_width_of_the_pictures(width):
    counts, scale = [OBSERVATIONS, OBSERVATIONS], width / 1000
    (good,) = point_findings(placed(counts, 1.49 * scale, width))
    assert good.level == "good" and good.text.startswith(f"{OBSERVATIONS} points")
    (doubt,) = point_findings(placed(counts, 1.51 * scale, width))
    assert doubt.level == "warn" and f"{1.51 * scale:.2f} pixels" in doubt.text


def test_cameras_of_few_observations_are_named():
    counts = [OBSERVATIONS, OBSERVATIONS - 1, OBSERVATIONS + 1]
    (finding,) = point_findings(placed(counts, 0.5))
    assert finding.level == "warn" and finding.text.startswith("camera1: fewer than 100")
    many = point_findings(placed([OBSERVATIONS] + 9 * [1], 0.5))[0].text
    assert "camera8 and 1 other:" in many and "camera9" not in many


@pytest.mark.parametrize(("width", "fewest"), [(128, 15), (640, 64), (1000, 100), (4000, 100)])
def test_a_calibrated_pose_is_not_weak_but_hardly_tested(width, fewest):
    (good,) = point_findings(placed([fewest, fewest], 0.1, width, known=True))
    assert good.level == "good"
    (doubt,) = point_findings(placed([fewest, fewest - 1], 0.1, width, known=True))
    assert doubt.level == "warn" and "weak" not in doubt.text
    text = f"camera1: fewer than {fewest} observations; few points to check the pose with"
    assert doubt.text == text


@pytest.mark.parametrize("matched", [True, False])
def test_a_calibrated_camera_without_a_match_is_told_apart_from_those_of_few_points(matched):
    found = placed([OBSERVATIONS, 3, 0], 0.1, known=True)
    rows = np.zeros((20, 2), int)
    pairs = {("0.png", "1.png"): rows} | ({("1.png", "2.png"): rows} if matched else {})
    *untested, few = point_findings(dataclasses.replace(found, matches=pairs))
    assert few.level == "warn" and few.remedy.startswith("Look at the epipolar lines.")
    if matched:
        # Its matches become no points: the lines show why.
        assert not untested and few.text.startswith("camera1, camera2: fewer than 100")
        return
    assert few.text.startswith("camera1: fewer than 100 observations")
    (alone,) = untested
    assert alone.text == "camera2: no match with any other camera; nothing tests the pose"
    assert alone.level == "warn" and "epipolar lines" not in alone.remedy
    # An estimated pose has been found by matches.
    (weak,) = point_findings(dataclasses.replace(found, known=False))
    assert weak.text.startswith("camera1, camera2: fewer")


def test_a_capture_without_points_is_doubtful():
    (finding,) = point_findings(placed([0, 0], 0.0))
    assert finding.level == "warn" and finding.text == "no point is seen by two cameras"


@pytest.mark.parametrize(("size", "wider"), [((400, 300), True), ((800, 600), False)])
@pytest.mark.parametrize("features", [True, False])
@pytest.mark.parametrize(("more", "told"), [(10, True), (0, False)])
def test_keys_are_named_only_where_they_change_something(size, wider, features, more, told):
    """Timestamps are left for cameras that stand still alone, and more features for pictures that
    have as many as are taken."""
    found = placed([OBSERVATIONS, 3], 0.5)
    pictures = {f: MatchingPicture(f, p.camera, 0, size) for f, p in found.pictures.items()}
    # That the other picture has as many as are taken does not help this one.
    full = frozenset(["1.png" if features else "0.png"])
    found = dataclasses.replace(found, pictures=pictures, more_instants=more, full_pictures=full)
    (finding,) = point_findings(found)
    larger = wider and not features
    assert ("larger pictures (these have 400 pixels)" in finding.remedy) == larger
    assert ("poses.features=16384" in finding.remedy) == features
    assert ("frames.instants=10" in finding.remedy) == told
    if not (larger or features or told):
        assert finding.remedy == "For more points: cameras closer to each other, more texture."
    (moving,) = point_findings(dataclasses.replace(found, still=frozenset()))
    assert "frames.instants" not in moving.remedy
