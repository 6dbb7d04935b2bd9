"""What is said about the distances of matches from their epipolar lines."""

import numpy as np
import pytest

from gaussray.prepare.epipolar import EpipolarPair
from gaussray.prepare.findings.epipolar_lines import EVIDENCE, epipolar_findings
from gaussray.prepare.poses import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


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
