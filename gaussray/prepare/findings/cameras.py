"""Whether the pictures have poses, and whether the cameras stand close enough to each other."""

import numpy as np

from gaussray.prepare.findings.doubtful_motion import standing_advice
from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.findings.lens_advice import lens_advice
from gaussray.prepare.findings.listed_pictures import listed_pictures
from gaussray.prepare.findings.more_matches import more_matches
from gaussray.prepare.findings.untested_poses import untested_pictures
from gaussray.prepare.placed_cameras import neighbour_angles
from gaussray.prepare.placement import Placement
from gaussray.runtime.output import listed_names


# Share of pictures that must be registered.
REGISTERED = 0.5
# Angle in degrees between a camera and its next neighbour, seen from the middle of the points.
APART = 45.0


def camera_findings(placement: Placement) -> list[Finding]:
    """Registered pictures, and the angles between neighbours."""
    model = placement.model
    total, found = len(placement.pictures), len(model.pictures)
    missing = [
        picture
        for file, picture in placement.pictures.items()
        if file not in model.pictures and file not in placement.strays
    ]
    more = " or ".join(more_matches(placement, missing))
    ways = [
        "Add cameras between their neighbours, or pictures with more texture",
        *([f"for more matches, {more}"] if more else []),
        lens_advice(placement),
        "or give a calibration",
    ]
    remedy = f"{'; '.join(ways)}."
    if found < max(2, REGISTERED * total):
        right = " that can be right" if placement.strays else ""
        text = f"only {found} of {total} pictures have a pose{right}"
        if placement.rig_untold:
            remedy += f" {standing_advice(placement)}"
        return [Finding("refuse", "cameras", text, remedy)]
    if missing:
        names = listed_pictures(missing, placement)
        text = f"{total - len(missing)} of {total} pictures have a pose; left out: {names}"
        findings = [Finding("warn", "cameras", text, remedy)]
    elif placement.strays:
        # Their own finding says so (`without_strays`).
        findings = []
    else:
        untested = len(untested_pictures(placement))
        kind = f"a {'calibrated ' if placement.known else ''}pose"
        but = f", {untested} of which no match tests" if untested else ""
        findings = [Finding("good", "cameras", f"all {total} pictures have {kind}{but}")]
    if len(model.points) and found > 1:
        apart = neighbour_angles(placement)
        cameras = [placement.pictures[file].camera for file in model.pictures]
        apart = np.where([camera in placement.still for camera in cameras], apart, 0)
        far = np.flatnonzero(apart > APART)
        if len(far):
            names = listed_names([cameras[k] for k in far])
            findings.append(
                Finding(
                    "warn",
                    "cameras",
                    f"{names}: the next camera is {np.max(apart):.0f} degrees away, seen from the "
                    "middle of the points; surfaces between them are guessed",
                    "Place cameras 15 to 30 degrees from each other.",
                )
            )
    return findings
