"""Whether matches lie on their epipolar lines: the test of a known calibration."""

from collections.abc import Sequence

import numpy as np

from gaussray.prepare.epipolar import EpipolarPair
from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.poses import Placement


# Pixels, for each 1000 pixels of width, above which epipolar errors are doubtful or, with known
# cameras, show another calibration.
DOUBTFUL_LINES, WRONG_LINES = 3.0, 25.0
# Matches of a pair that prove something: wide baselines give some twenty that are all wrong.
EVIDENCE = 40


def epipolar_findings(placement: Placement, pairs: Sequence[EpipolarPair]) -> list[Finding]:
    """Distances of matches from the epipolar lines; the test of a known calibration.

    Args:
        placement: lenses, and whether they come from a calibration.
        pairs: pairs of pictures; those with fewer than `EVIDENCE` matches do not count.
    """
    scale = max((lens["w"] for lens in placement.model.lenses), default=1000) / 1000
    known = [pair for pair in pairs if np.isfinite(pair.median) and pair.count >= EVIDENCE]
    if not known:
        text = "no two pictures share enough matches to test the poses"
        remedy = "Check by eye that the drawn lines pass through the same things, if there are any."
        return [Finding("warn", "epipolar lines", text, remedy)]
    typical = float(np.median([pair.median for pair in known]))
    text = f"matches are {typical:.2f} pixels from their epipolar lines (median of the pairs)"
    if typical > WRONG_LINES * scale and placement.known:
        remedy = (
            "The calibration is not of these pictures: check the order of the cameras, their "
            "names, zoom, and that no camera was moved since."
        )
        return [Finding("refuse", "epipolar lines", text, remedy)]
    if typical > DOUBTFUL_LINES * scale:
        if placement.known:
            text += "; compare the result without poses.calibration"
        remedy = "fit.refine=[pose,lens] may repair it; a new calibration is better."
        return [Finding("warn", "epipolar lines", text, remedy)]
    return [Finding("good", "epipolar lines", text)]
