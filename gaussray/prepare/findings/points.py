"""Whether enough points are seen, and seen where the cameras say."""

import numpy as np

from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.findings.listed_pictures import listed_pictures
from gaussray.prepare.findings.more_matches import more_matches
from gaussray.prepare.findings.untested_poses import untested_pictures
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import observations_by_picture


# Pixels, for each 1000 pixels of width, above which reprojection errors are doubtful.
DOUBTFUL_ERROR = 1.5
# Fewest observations of a picture that has a pose by them.
OBSERVATIONS = 100
# Fewest that test a known pose, which is less than `OBSERVATIONS` in proportion to the width where
# pictures are less than 1000 pixels wide.
_TESTING = 15


def point_findings(placement: Placement) -> list[Finding]:
    """Reprojection errors and numbers of observations."""
    model = placement.model
    if not len(model.points):
        text = "no point is seen by two cameras"
        remedy = (
            "The capture then starts from points on pictures alone (docs/reconstruction.md); check "
            "by the epipolar lines that calibration and videos belong together."
        )
        return [Finding("warn", "points", text, remedy)]
    shown = [placement.pictures[file] for file in model.pictures]
    counts = zip(shown, observations_by_picture(model), strict=True)
    scale = max(lens["w"] for lens in model.lenses) / 1000
    fewest = OBSERVATIONS
    if placement.known:
        fewest = round(max(OBSERVATIONS * min(1, scale), _TESTING))
    untested = untested_pictures(placement)
    weak = [picture for picture, count in counts if count < fewest and picture not in untested]
    median = float(np.median(model.observations.error))
    findings = []
    if median > DOUBTFUL_ERROR * scale:
        text = f"the median reprojection error is {median:.2f} pixels"
        remedy = "fit.refine=[pose,lens] may repair it; look at the epipolar lines first."
        findings.append(Finding("warn", "points", text, remedy))
    if untested:
        names = listed_pictures(untested, placement)
        text = f"{names}: no match with any other camera; nothing tests the pose"
        more = ", ".join(["more texture", *more_matches(placement, untested)])
        remedy = (
            "Compare the pictures with those that gaussray evaluate renders from the same place. "
            f"For matches: cameras closer to each other, {more}."
        )
        findings.append(Finding("warn", "points", text, remedy))
    if weak:
        names = listed_pictures(weak, placement)
        text = f"{names}: fewer than {fewest} observations"
        more = ", ".join(["more texture", *more_matches(placement, weak)])
        remedy = f"For more points: cameras closer to each other, {more}."
        if placement.known:
            text += "; few points to check the pose with"
            remedy = f"Look at the epipolar lines. {remedy}"
        else:
            text += "; the pose is weak"
        findings.append(Finding("warn", "points", text, remedy))
    if not findings:
        text = f"{len(model.points)} points, median reprojection error {median:.2f} pixels"
        findings.append(Finding("good", "points", text))
    return findings
