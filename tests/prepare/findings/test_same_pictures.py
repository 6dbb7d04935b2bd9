"""Two cameras that show the same pictures are told of."""

import dataclasses

import numpy as np
import pytest

from gaussray.dataset.images import write_image
from gaussray.prepare.features import Keypoints, MatchingPicture
from gaussray.prepare.findings.same_pictures import same_picture_findings
from gaussray.prepare.overlays import PictureOverlay
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


def placed(shift, times=5, moved=0, still=False):
    """A video of 640 x 480, and another one of half the size.

    Args:
        shift: pixels by which things in the second one are elsewhere.
        times: number of timestamps.
        moved: at so many timestamps they are elsewhere by 10 pixels more.
        still: whether the cameras stand still: one picture each.
    """
    nothing, rows = np.zeros(0, int), np.stack([np.arange(60)] * 2, axis=1)
    seen = Observations(nothing, nothing, nothing, np.zeros((0, 2)), np.zeros(0))
    model = SparseModel([], np.zeros((0, 3, 4)), [], np.zeros((0, 3)), seen)
    pictures, keypoints, matches = {}, {}, {}
    for k in range(1 if still else times):
        places = np.random.default_rng(k).uniform(0, 480, (60, 2))
        other = (places + shift + 10 * (k < moved)) / 2
        for name, size, xy in (("a", (640, 480), places), ("b", (320, 240), other)):
            file = f"{name}{k}.png"
            pictures[file] = MatchingPicture(file, name, k, size)
            keypoints[file] = Keypoints(xy, np.full(60, k))
        matches[f"a{k}.png", f"b{k}.png"] = rows
        # What moves past shows at another time what stood there before.
        matches["a0.png", f"b{k}.png"] = rows
    names = frozenset("ab" if still else "")
    return Placement(model, pictures, keypoints, matches, names, known=False)


def shown(folder, differ=False):
    """The files of both videos at five times, of one scene or of two."""
    files = {"a": [], "b": []}
    for name, size in (("a", (640, 480)), ("b", (320, 240))):
        for k in range(5):
            seed = 10 * k + (differ and name == "b")
            coarse = np.random.default_rng(seed).integers(0, 256, (24, 32, 3)).astype(np.uint8)
            times = size[0] // 32
            files[name].append(folder / f"{name}{k}.png")
            write_image(files[name][-1], coarse.repeat(times, 0).repeat(times, 1))
    return files


def test_a_logo_over_different_pictures_makes_no_copy(tmp_path):
    (finding,) = same_picture_findings(placed(0.0), shown(tmp_path, differ=True))
    assert finding.level == "warn" and "show the same pictures" not in finding.text
    assert "a and b show different things" in finding.text and "a logo" in finding.text
    assert "cut it off" in finding.remedy


def test_matches_that_were_not_used_are_told_of():
    overlays = (PictureOverlay(("a", "b"), 40, 60), PictureOverlay(("a", "a"), 3, 4))
    placement = dataclasses.replace(placed(5.0), overlays=overlays)
    (both,) = same_picture_findings(placement, {})
    assert "(40 of 60 matches) (and 1 other alike); these matches are not used" in both.text
    (alone,) = same_picture_findings(dataclasses.replace(placement, overlays=overlays[1:]), {})
    assert alone.text.startswith("a: the pictures differ") and "stands still" in alone.text


@pytest.mark.parametrize(
    ("placement", "told"),
    [
        (placed(0.5), "a and b show the same pictures at 5 of 5 timestamps, as a video"),
        (placed(0.0, moved=1), "a and b show the same pictures at 4 of 5 timestamps, as a video"),
        (placed(0.0, moved=2), ""),
        (placed(5.0), ""),
        (placed(0.0, still=True), "a and b show the same pictures, as a video"),
    ],
)
def test_a_video_and_its_copy_of_half_the_size_are_told_of(tmp_path, placement, told):
    findings = same_picture_findings(placement, shown(tmp_path))
    assert [one.level for one in findings] == ["warn"] * bool(told)
    assert not told or findings[0].text.startswith(told)


def test_pictures_of_one_camera_and_few_matches_tell_nothing():
    placement = placed(0.0)
    few = {pair: rows[:39] for pair, rows in placement.matches.items()}
    assert not same_picture_findings(dataclasses.replace(placement, matches=few), {})
    one = {file: dataclasses.replace(p, camera="a") for file, p in placement.pictures.items()}
    assert not same_picture_findings(dataclasses.replace(placement, pictures=one), {})


@pytest.mark.parametrize(("near", "told"), [(12, False), (3, True)])
def test_a_far_background_does_not_hide_what_is_near(tmp_path, near, told):
    """Of 60 matches some are of things so near that they are elsewhere in a rectified pair."""
    placement = placed(0.0)
    keypoints = dict(placement.keypoints)
    for file, points in keypoints.items():
        if file.startswith("b"):
            keypoints[file] = dataclasses.replace(
                points, xy=points.xy + 5.0 * (np.arange(60) < near)[:, None]
            )
    changed = dataclasses.replace(placement, keypoints=keypoints)
    findings = same_picture_findings(changed, shown(tmp_path))
    assert bool(findings) == told
