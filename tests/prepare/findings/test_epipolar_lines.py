"""What is said about the distances of matches from their epipolar lines."""

import dataclasses
import re

import numpy as np
import pytest

from gaussray.prepare.epipolar import EpipolarPair, epipolar_pairs
from gaussray.prepare.features import Keypoints, MatchingPicture
from gaussray.prepare.findings import calibration_readings
from gaussray.prepare.findings.epipolar_lines import epipolar_findings
from gaussray.prepare.findings.pair_distances import EVIDENCE, PairDistance
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel
from gaussray.prepare.stray_poses import without_strays


pytest.importorskip("pycolmap")

WIDTH, HEIGHT, FOCAL = 640, 480, 500.0


def turned(degrees):
    """A rotation about the y axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def true_poses(count):
    """World to camera of cameras on an arc of irregular height that look at the origin."""
    poses = []
    for k in range(count):
        back = turned(25.0 * k) @ np.array([0, 0, -4.0 - 0.3 * (k % 2)])
        eye = back + np.array([0, 0.5 * (-1) ** k, 0])
        forward = -eye / np.linalg.norm(eye)
        right = np.cross([0, 1, 0], forward)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        poses.append(np.column_stack([rotation, -rotation @ eye]))
    return np.array(poses)


def rig(count, poses=None, factor=1.0, matches=60, neighbours=2):
    """Cameras that share points with their next neighbours, as a calibration has them.

    Args:
        count: number of cameras.
        poses: world to camera as the calibration says; None: as they are.
        factor: how many times as large the pictures of the calibration are.
        matches: number of matches of each pair.
        neighbours: pairs are so many cameras apart at most.
    """
    points = np.random.default_rng(0).uniform(-1, 1, (matches, 3))
    lens = {"camera_model": "PINHOLE", "w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "fl_y": FOCAL}
    lens |= {"cx": WIDTH / 2, "cy": HEIGHT / 2}
    keypoints, files = {}, [f"{k}.png" for k in range(count)]
    noise = np.random.default_rng(1)
    for file, pose in zip(files, true_poses(count), strict=True):
        inside = points @ pose[:, :3].T + pose[:, 3]
        pixel = FOCAL * inside[:, :2] / inside[:, 2:] + [lens["cx"], lens["cy"]]
        pixel += 0.2 * noise.normal(size=pixel.shape)
        keypoints[file] = Keypoints(pixel, np.zeros(matches, int))
    same = np.stack([np.arange(matches)] * 2, axis=1)
    pairs = {
        (files[i], files[k]): same
        for i in range(count)
        for k in range(i + 1, min(i + 1 + neighbours, count))
    }
    calibrated = lens | {key: factor * lens[key] for key in ("fl_x", "fl_y", "cx", "cy")}
    poses = true_poses(count) if poses is None else poses
    nothing = np.zeros(0, int)
    seen = Observations(nothing, nothing, nothing, np.zeros((0, 2)), np.zeros(0))
    model = SparseModel(files, poses, [dict(calibrated) for _ in files], np.zeros((0, 3)), seen)
    pictures = {f: MatchingPicture(f, f"cam{k}", 0, (640, 480)) for k, f in enumerate(files)}
    still = frozenset(picture.camera for picture in pictures.values())
    return Placement(model, pictures, keypoints, pairs, still, known=True)


def said(placement, most=6):
    """The finding about a rig."""
    (finding,) = epipolar_findings(placement, epipolar_pairs(placement, most))
    return finding


def with_pose(poses, index, change):
    """The poses, of which one is another one."""
    poses = poses.copy()
    poses[index] = change(poses[index])
    return poses


def inverse(pose):
    return np.column_stack([pose[:, :3].T, -pose[:, :3].T @ pose[:, 3]])


def test_a_correct_calibration_is_good_and_no_camera_is_named():
    assert said(rig(6)) == ("good", "epipolar lines", said(rig(6)).text, "")
    assert "cam" not in said(rig(6)).text


def test_a_camera_that_was_turned_is_named_with_its_distances():
    """Two of the six pairs that are drawn are off, so their median is as good as ever."""
    poses = with_pose(true_poses(8), 3, lambda pose: turned(6) @ pose)
    finding = said(rig(8, poses, neighbours=1))
    assert (
        finding.level == "warn" and "cam3: " in finding.text and "pixels with cam" in finding.text
    )
    assert "with cam2" in finding.text and "with cam4" in finding.text
    assert "those of all other pairs are at most 0.2" in finding.text
    assert "moved or turned since the calibration" in finding.remedy
    unknown = dataclasses.replace(rig(8, poses, neighbours=1), known=False)
    finding = said(unknown)
    assert finding.level == "warn" and "those of cam3 " in finding.text
    assert "moved" not in finding.remedy and "poses.lens=FILE" in finding.remedy
    right = dataclasses.replace(rig(8, neighbours=1), known=False)
    assert said(right).level == "good"


def test_a_pair_that_contradicts_estimated_poses_is_named_where_neither_picture_is_odd():
    placement = dataclasses.replace(rig(6, neighbours=5, matches=150), known=False)
    wrong = np.stack([np.arange(150), np.roll(np.arange(150), 1)], axis=1)
    matches = placement.matches | {("2.png", "3.png"): wrong}
    finding = said(dataclasses.replace(placement, matches=matches))
    assert finding.level == "warn" and "those of cam2 and cam3 " in finding.text
    assert "one of both is misplaced" in finding.text
    assert "poses.fov=DEGREES if you know the lens; or take them away" in finding.remedy
    given = said(dataclasses.replace(placement, matches=matches, fov_given=True))
    assert "poses.fov=" not in given.remedy and "check poses.fov" in given.remedy
    few = {pair: rows[:60] for pair, rows in matches.items()}
    assert said(dataclasses.replace(placement, matches=few)).level == "good"


def with_observations(placement):
    """The placement of cameras that move, in which every picture sees some points."""
    model = placement.model
    point, picture = (x.ravel() for x in np.meshgrid(range(30), range(len(model.pictures))))
    zeros = np.zeros(len(point))
    seen = Observations(point, picture, point, np.zeros((len(point), 2)), zeros)
    points = np.random.default_rng(0).uniform(-1, 1, (30, 3))
    model = dataclasses.replace(model, points=points, observations=seen)
    return dataclasses.replace(placement, model=model, known=False, still=frozenset())


def test_a_picture_that_its_matches_contradict_is_left_out_unless_its_camera_stands_still():
    """It is as close to the others as ever, and sees as many points."""
    poses = with_pose(true_poses(6), 3, lambda pose: turned(6) @ pose)
    moving = with_observations(rig(6, poses, neighbours=5))
    kept, (finding,) = without_strays(moving)
    assert kept.model.pictures == [f"{k}.png" for k in (0, 1, 2, 4, 5)]
    assert finding.level == "warn" and "cam3 0 (matches are" in finding.text
    assert re.search(
        "pixels from their epipolar lines, those of the others 0[.][0-9]+", finding.text
    )
    assert said(kept).level == "good"
    still = dataclasses.replace(moving, still=frozenset(f"cam{k}" for k in range(6)))
    assert without_strays(still) == (still, [])
    assert "those of cam3 " in said(still).text
    right = with_observations(rig(6, neighbours=5))
    assert without_strays(right) == (right, [])


def test_matches_that_prove_nothing_name_no_camera():
    poses = with_pose(true_poses(8), 3, lambda pose: turned(6) @ pose)
    placement = rig(8, poses, neighbours=1)
    few = {pair: rows[:20] if "3.png" in pair else rows for pair, rows in placement.matches.items()}
    assert said(dataclasses.replace(placement, matches=few)).level == "good"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (inverse, "if R and t are camera-to-world: invert them"),
        (lambda pose: pose * [1, 1, 1, 1e-3], "if t has another unit: multiply it by 1000"),
    ],
)
def test_one_camera_of_another_convention_is_told_how(change, words):
    finding = said(rig(4, with_pose(true_poses(4), 3, change), neighbours=3))
    assert "cam3: " in finding.text and "those of cam3 fit (0." in finding.text
    assert finding.text.endswith(words) and finding.remedy.startswith("Correct")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rig(5, np.array([inverse(x) for x in true_poses(5)])), "camera-to-world: invert"),
        (lambda: rig(5), ""),
        (lambda: rig(5, np.diag([1, -1, -1]) @ true_poses(5)), "axes are OpenGL's"),
        (lambda: rig(5, factor=2.0), "is of pictures of about 1280 x 960"),
        (lambda: rig(5, factor=3.0), "is of pictures of about 1920 x 1440"),
        (lambda: rig(5, true_poses(5)[[1, 0, 2, 3, 4]]), "cam0 and cam1 are exchanged"),
        (lambda: rig(4, true_poses(4)[[2, 1, 0, 3]]), "cam0 and cam2 are exchanged"),
    ],
)
def test_the_reading_with_which_a_calibration_fits_is_told(make, words):
    finding = said(make())
    assert ("fit (0." in finding.text) == bool(words) and words in finding.text
    assert (finding.level == "good") == (not words)


@pytest.mark.parametrize(("share", "told"), [(0.7, False), (0.9, True)])
def test_a_reading_with_which_many_matches_have_no_ray_is_none(monkeypatch, share, told):
    placement, measured = rig(5, factor=2.0), calibration_readings.pair_distances

    def losing(other, pairs):
        kept = 1 if other is placement else share
        found = measured(other, pairs).items()
        return {pair: PairDistance(int(kept * n), median) for pair, (n, median) in found}

    monkeypatch.setattr(calibration_readings, "pair_distances", losing)
    assert ("1280 x 960" in said(placement).text) == told


def test_a_pair_of_few_matches_that_fits_nowhere_is_left_out():
    poses = with_pose(true_poses(8), 1, lambda pose: turned(6) @ pose)
    placement = rig(8, with_pose(poses, 7, lambda pose: turned(6) @ pose), neighbours=1)
    text = said(placement).text
    assert "cam1: " in text and "cam7: " not in text
    assert "those of most other pairs are at most 0.2" in text


def test_two_exchanged_cameras_of_many_are_told_though_many_pairs_fit():
    finding = said(rig(12, true_poses(12)[[0, 1, 9, 3, 4, 5, 6, 7, 8, 2, 10, 11]]))
    assert "cam2: " in finding.text and "cam9: " in finding.text
    assert finding.text.endswith("cam2 and cam9 are exchanged")


def test_a_calibration_of_something_else_fits_in_no_reading():
    poses = true_poses(5)
    poses[:, :, :3] = np.stack([turned(40 * k**2) @ np.roll(np.eye(3), k, 0) for k in range(5)])
    finding = said(rig(5, poses))
    assert finding.level == "refuse" and "fit (" not in finding.text
    assert finding.remedy.startswith("The calibration is not of these pictures")


def placed(known, width=640):
    """Two cameras of so wide pictures that see no points."""
    nothing = np.zeros(0, int)
    seen = Observations(nothing, nothing, nothing, np.zeros((0, 2)), np.zeros(0))
    lens = {"camera_model": "OPENCV", "w": width, "h": 480}
    model = SparseModel([], np.zeros((0, 3, 4)), [lens], np.zeros((0, 3)), seen)
    return Placement(model, {}, {}, {}, still=frozenset("ab"), known=known)


def pairs(*medians, count=EVIDENCE):
    return [EpipolarPair("a", "b", count, median, [], []) for median in medians]


@pytest.mark.parametrize("known", [True, False])
def test_without_a_calibration_that_is_doubtful_the_result_is_to_be_compared(known):
    (finding,) = epipolar_findings(placed(known), pairs(2.2))
    assert finding.level == "warn" and "2.20 pixels" in finding.text
    assert ("compare the result without poses.calibration" in finding.text) == known
    (good,) = epipolar_findings(placed(known), pairs(1.0))
    assert good.level == "good" and "compare" not in good.text


@pytest.mark.parametrize(("known", "level"), [(True, "refuse"), (False, "warn")])
def test_lines_far_away_refuse_a_calibration_and_no_estimate(known, level):
    """Of pictures 2000 pixels wide, 50 pixels are the limit."""
    assert epipolar_findings(placed(known, 2000), pairs(51.0))[0].level == level
    assert epipolar_findings(placed(known, 2000), pairs(49.0))[0].level == "warn"


def test_the_median_of_the_pairs_counts():
    (finding,) = epipolar_findings(placed(True), pairs(0.5, 1.0, 100.0))
    assert finding.level == "good" and "1.00 pixels" in finding.text


def test_pairs_of_few_matches_prove_nothing():
    few = pairs(100.0, count=EVIDENCE - 1) + pairs(np.nan)
    (finding,) = epipolar_findings(placed(True), few)
    assert finding.level == "warn" and "no two pictures share enough matches" in finding.text
    assert epipolar_findings(placed(True), few + pairs(1.0))[0].level == "good"
