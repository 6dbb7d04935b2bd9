"""What the checks say."""

import numpy as np
import pytest

from gaussray.prepare.epipolar import EpipolarPair
from gaussray.prepare.findings import EVIDENCE, epipolar_findings
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
