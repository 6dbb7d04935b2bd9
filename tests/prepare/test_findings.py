"""What the checks say."""

import numpy as np
import pytest

from gaussray.prepare.epipolar import EpipolarPair
from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.findings import EVIDENCE, camera_findings, epipolar_findings
from gaussray.prepare.poses import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


@pytest.mark.parametrize("known", [True, False])
def test_without_a_calibration_that_is_doubtful_the_result_is_to_be_compared(known):
    nothing = np.zeros(0, int)
    seen = Observations(nothing, nothing, nothing, np.zeros((0, 2)), np.zeros(0))
    lens = {"camera_model": "OPENCV", "w": 640, "h": 480}
    model = SparseModel([], np.zeros((0, 3, 4)), [lens], np.zeros((0, 3)), seen)
    placement = Placement(model, {}, {}, {}, still=frozenset("ab"), known=known)
    (finding,) = epipolar_findings(placement, [EpipolarPair("a", "b", EVIDENCE, 2.2, [], [])])
    assert finding.level == "warn" and "2.20 pixels" in finding.text
    assert ("compare the result without poses.calibration" in finding.text) == known
    (good,) = epipolar_findings(placement, [EpipolarPair("a", "b", EVIDENCE, 1.0, [], [])])
    assert good.level == "good" and "compare" not in good.text


def test_photographs_are_named_by_their_files_and_frames_of_videos_by_their_number():
    nothing = np.zeros(0, int)
    seen = Observations(nothing, nothing, nothing, np.zeros((0, 2)), np.zeros(0))
    files = [f"{k}.png" for k in range(4)]
    model = SparseModel(files[:3], np.zeros((3, 3, 4)), [], np.zeros((0, 3)), seen)

    def left_out(camera, photograph, still=()):
        last = MatchingPicture("3.png", camera, 3, (4, 3), photograph)
        pictures = {file: MatchingPicture(file, "sub", 0, (4, 3), "a.jpg") for file in files[:3]}
        pictures["3.png"] = last
        placement = Placement(model, pictures, {}, {}, still=frozenset(still), known=False)
        return camera_findings(placement)[0].text.split("left out: ")[1]

    assert left_out("sub", "frame-07.color.jpg") == "frame-07.color.jpg"
    assert left_out("other", "frame-07.color.jpg") == "other/frame-07.color.jpg"
    assert left_out("other", "") == "other 3"
    assert left_out("other", "frame-07.color.jpg", still=["other"]) == "other"
