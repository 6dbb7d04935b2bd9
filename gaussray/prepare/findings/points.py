"""Whether enough points are seen, and seen where the cameras say."""

import numpy as np

from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.placed_cameras import picture_name
from gaussray.prepare.poses import Placement
from gaussray.prepare.sparse_model import observations_by_picture


# Pixels, for each 1000 pixels of width, above which reprojection errors are doubtful.
DOUBTFUL_ERROR = 1.5
# Fewest observations of a picture.
OBSERVATIONS = 100


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
    few = [picture_name(p, placement) for p, count in counts if count < OBSERVATIONS]
    scale = max(lens["w"] for lens in model.lenses) / 1000
    median = float(np.median(model.observations.error))
    findings = []
    if median > DOUBTFUL_ERROR * scale:
        text = f"the median reprojection error is {median:.2f} pixels"
        remedy = "fit.refine=[pose,lens] may repair it; look at the epipolar lines first."
        findings.append(Finding("warn", "points", text, remedy))
    if few:
        names = ", ".join(few[:8]) + ("..." if len(few) > 8 else "")
        findings.append(
            Finding(
                "warn",
                "points",
                f"{names}: fewer than {OBSERVATIONS} observations; the pose is weak",
                "Cameras closer to each other, larger pictures, more texture; frames.instants=10.",
            )
        )
    if not findings:
        text = f"{len(model.points)} points, median reprojection error {median:.2f} pixels"
        findings.append(Finding("good", "points", text))
    return findings
