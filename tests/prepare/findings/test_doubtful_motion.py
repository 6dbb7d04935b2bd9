"""What is said of the motion of cameras that may stand still."""

import dataclasses

import numpy as np
import pytest

from gaussray.prepare.features import Keypoints, MatchingPicture
from gaussray.prepare.findings.cameras import camera_findings
from gaussray.prepare.findings.doubtful_motion import doubtful_motion_findings
from gaussray.prepare.findings.points import OBSERVATIONS
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


SIZE, COUNT, MATCHES = (1000, 500), 12, 40


def placed(observations=OBSERVATIONS, focal="pictures", staying=0.0, untold=True):
    """Pictures of one camera, each of which sees so many points, and shares matches with all; such
    a share of them stays in place where the pictures are more than two apart in time."""
    points = np.random.default_rng(0).uniform(0.1, 0.4, (MATCHES, 2)) * SIZE
    names = [f"{k:02d}.png" for k in range(COUNT)]
    stays = np.arange(MATCHES)[:, None] < staying * MATCHES
    keypoints = {
        name: Keypoints(np.where(stays, points, points + (20 * k, 0)), np.full(MATCHES, k))
        for k, name in enumerate(names)
    }
    rows = np.repeat(np.arange(MATCHES)[:, None], 2, axis=1)
    matches = {(a, b): rows for k, a in enumerate(names) for b in names[k + 1 :]}
    picture = np.repeat(np.arange(COUNT), observations)
    point = np.tile(np.arange(observations), COUNT)
    zeros = np.zeros(len(point))
    seen = Observations(point, picture, point, np.zeros((len(point), 2)), zeros)
    poses = np.tile(np.eye(4)[:3], (COUNT, 1, 1))
    model = SparseModel(names, poses, [], np.zeros((observations, 3)), seen, focal)
    pictures = {n: MatchingPicture(n, "video", k, SIZE) for k, n in enumerate(names)}
    return Placement(model, pictures, keypoints, matches, frozenset(), False, rig_untold=untold)


WEAK = OBSERVATIONS - 1


@pytest.mark.parametrize(
    ("signs", "told"),
    [
        ({"observations": WEAK, "focal": "guess"}, ["99", "focal"]),
        ({"observations": WEAK, "staying": 0.1}, ["99", "10 %"]),
        ({"focal": "guess", "staying": 0.1}, ["focal", "10 %"]),
        ({"focal": "guess", "staying": 0.025}, []),
        ({"focal": "guess"}, []),
        ({"observations": WEAK}, []),
        ({"staying": 0.5}, []),
        ({}, []),
    ],
)
def test_two_signs_make_motion_doubtful_where_pictures_do_not_tell_of_it(signs, told):
    found = doubtful_motion_findings(placed(**signs))
    assert bool(found) == bool(told)
    for finding in found:
        assert finding.level == "warn" and "add their videos" in finding.remedy
        assert finding.text.startswith("video: the pictures do not tell whether the camera stands")
        assert ("12 of 12 poses are weak" in finding.text) == ("99" in told)
        assert ("do not tell the focal length" in finding.text) == ("focal" in told)
        assert ("10 % of the matches stay in place" in finding.text) == ("10 %" in told)
    # Cameras that were seen to move, or are said to, are believed.
    assert not doubtful_motion_findings(placed(**signs, untold=False))


def test_that_neighbours_in_time_look_alike_is_no_sign():
    found = placed(observations=WEAK)
    slow = {
        name: Keypoints(one.xy if k > 1 else found.keypoints["00.png"].xy, one.instant)
        for k, (name, one) in enumerate(found.keypoints.items())
    }
    near = {pair: rows for pair, rows in found.matches.items() if "00.png" in pair}
    near = dataclasses.replace(found, keypoints=slow, matches=near)
    assert not doubtful_motion_findings(near)


def test_a_refusal_of_such_cameras_names_what_to_set():
    found = placed()
    few = dataclasses.replace(found.model, pictures=found.model.pictures[:3])
    (refused,) = camera_findings(dataclasses.replace(found, model=few))
    assert refused.level == "refuse" and refused.remedy.endswith("add their videos.")
    pictures = {
        file: dataclasses.replace(picture, camera=file[:2])
        for file, picture in found.pictures.items()
    }
    several = dataclasses.replace(found, model=few, pictures=pictures)
    assert camera_findings(several)[0].remedy.endswith("set poses.rig=still.")
    told = dataclasses.replace(found, model=few, rig_untold=False)
    assert "poses.rig" not in camera_findings(told)[0].remedy
