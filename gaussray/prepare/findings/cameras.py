"""Whether the pictures have poses, and whether the cameras stand close enough to each other."""

import numpy as np

from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.findings.listed_pictures import listed_pictures
from gaussray.prepare.findings.more_matches import more_matches
from gaussray.prepare.placed_cameras import neighbour_angles
from gaussray.prepare.poses import Placement
from gaussray.runtime.output import listed_names


# Share of pictures that must be registered.
REGISTERED = 0.5
# Angle in degrees between a camera and its next neighbour, seen from the middle of the points.
APART = 45.0


def camera_findings(placement: Placement) -> list[Finding]:
    """Registered pictures, and the angles between neighbours."""
    model = placement.model
    total, found = len(placement.pictures), len(model.pictures)
    missing = [p for f, p in placement.pictures.items() if f not in model.pictures]
    lens = (
        "check that poses.lens is of this camera, zoom and size of pictures, or leave it out."
        if model.focal_source == "lens"
        else "poses.lens=FILE or poses.fov=DEGREES if you know the lens; or give a calibration."
    )
    more = more_matches(placement, missing)
    finds = f"{' and '.join(more)} {'find' if len(more) > 1 else 'finds'} more matches; "
    remedy = (
        "Add cameras between their neighbours, or pictures with more texture; "
        f"{finds if more else ''}{lens}"
    )
    if found < max(2, REGISTERED * total):
        text = f"only {found} of {total} pictures have a pose"
        return [Finding("refuse", "cameras", text, remedy)]
    if missing:
        names = listed_pictures(missing, placement)
        text = f"{found} of {total} pictures have a pose; left out: {names}"
        findings = [Finding("warn", "cameras", text, remedy)]
    else:
        kind = "a calibrated" if placement.known else "a"
        findings = [Finding("good", "cameras", f"all {total} pictures have {kind} pose")]
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
