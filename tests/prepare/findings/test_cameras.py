"""What is said about the poses of the pictures."""

import dataclasses

import numpy as np
import pytest

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.findings.cameras import camera_findings
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


def placed(angles, missing=0, known=False):
    """Cameras that stand still on a circle around the points, at these angles in degrees, and
    others without a pose."""
    nothing = np.zeros(0, int)
    seen = Observations(nothing, nothing, nothing, np.zeros((0, 2)), np.zeros(0))
    turns = np.radians(np.array(angles, float))
    poses = np.tile(np.eye(4)[:3], (len(angles), 1, 1))
    poses[:, :, 3] = -np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1)
    names = [f"camera{k}" for k in range(len(angles) + missing)]
    files = [f"{name}.png" for name in names]
    points = np.concatenate([np.eye(3), -np.eye(3)])
    model = SparseModel(files[: len(angles)], poses, [], points, seen)
    pictures = {f: MatchingPicture(f, n, 0, (4, 3)) for f, n in zip(files, names, strict=True)}
    return Placement(model, pictures, {}, {}, still=frozenset(names), known=known)


@pytest.mark.parametrize("known", [True, False])
def test_all_cameras_beside_each_other_are_good(known):
    found = placed([0, 44, 88], known=known)
    pairs = {(f"camera{k}.png", f"camera{k + 1}.png"): np.zeros((20, 2), int) for k in range(2)}
    (finding,) = camera_findings(dataclasses.replace(found, matches=pairs))
    assert finding.level == "good" and "all 3 pictures" in finding.text
    assert ("calibrated" in finding.text) == known


def test_a_camera_far_from_its_next_neighbour_is_named_with_the_angle():
    placement = placed([0, 30, 90])
    (_, far) = camera_findings(placement)
    assert far.level == "warn" and far.text.startswith("camera2: the next camera is 60 degrees")
    # Cameras that move are next to themselves.
    moving = dataclasses.replace(placement, still=frozenset())
    assert [finding.level for finding in camera_findings(moving)] == ["good"]


def test_half_of_the_pictures_must_have_a_pose():
    (finding,) = camera_findings(placed([0, 20], missing=2))
    assert finding.level == "warn" and finding.text.endswith("left out: camera2, camera3")
    (finding,) = camera_findings(placed([0, 20], missing=3))
    assert finding.level == "refuse" and finding.text == "only 2 of 5 pictures have a pose"
    (alone,) = camera_findings(placed([0]))
    assert alone.level == "refuse"


def test_missing_pictures_are_told_as_a_range():
    names = [f"{k:05d}.jpg" for k in range(65)]
    placement = placed([0] * 37, missing=28)
    pictures = {
        one.file: dataclasses.replace(one, camera="photos", instant=k, photograph=name)
        for k, (one, name) in enumerate(zip(placement.pictures.values(), names, strict=True))
    }
    changed = dataclasses.replace(placement, pictures=pictures, still=frozenset())
    finding = camera_findings(changed)[0]
    assert finding.text.endswith("37 of 65 pictures have a pose; left out: 00037.jpg to 00064.jpg")


@pytest.mark.parametrize(("more", "still"), [(8, True), (0, True), (8, False)])
def test_more_timestamps_are_recommended_only_where_a_still_camera_has_them(more, still):
    found = dataclasses.replace(placed([0, 20], missing=2), more_instants=more)
    found = found if still else dataclasses.replace(found, still=frozenset())
    remedy = camera_findings(found)[0].remedy
    assert ("frames.instants=8" in remedy) == (more > 0 and still)
    assert "larger pictures (these have 4 pixels)" in remedy
    assert remedy.count("for more matches, ") == 1


@pytest.mark.parametrize(("full", "key"), [("camera3.png", "poses.features=16384"), ("", "")])
def test_nothing_is_said_to_find_more_matches_where_nothing_does(full, key):
    found = placed([0, 20], missing=2)
    large = {f: dataclasses.replace(p, size=(1600, 900)) for f, p in found.pictures.items()}
    found = dataclasses.replace(found, pictures=large, full_pictures=frozenset([full]))
    remedy = camera_findings(found)[0].remedy
    more = f"for more matches, {key}; " if key else ""
    assert remedy == (
        f"Add cameras between their neighbours, or pictures with more texture; {more}"
        "poses.lens=FILE or poses.fov=DEGREES if you know the lens; or give a calibration."
    )


def test_a_field_of_view_that_is_given_is_not_asked_for():
    found = placed([0, 20], missing=2)
    assert "poses.fov=DEGREES" in camera_findings(found)[0].remedy
    remedy = camera_findings(dataclasses.replace(found, fov_given=True))[0].remedy
    assert "poses.fov=" not in remedy
    assert "check poses.fov, or give poses.lens=FILE in its place if you know the lens" in remedy
    lens = dataclasses.replace(found.model, focal_source="lens")
    remedy = camera_findings(dataclasses.replace(found, model=lens))[0].remedy
    assert "poses.fov" not in remedy and "check that poses.lens is of this camera" in remedy


@pytest.mark.parametrize("matched", [True, False])
def test_calibrated_poses_that_no_match_tests_are_counted(matched):
    found = placed([0, 44, 88], known=True)
    pairs = {("camera0.png", "camera1.png"): np.zeros((20, 2), int)}
    pairs[("camera1.png", "camera2.png")] = np.zeros((20 * matched, 2), int)
    (finding,) = camera_findings(dataclasses.replace(found, matches=pairs))
    assert finding.level == "good"
    assert finding.text == "all 3 pictures have a calibrated pose" + (
        "" if matched else ", 1 of which no match tests"
    )
