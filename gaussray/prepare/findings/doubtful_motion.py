"""Whether the motion of cameras that may stand still is doubtful."""

import numpy as np

from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.findings.points import OBSERVATIONS
from gaussray.prepare.overlays import at_same_place
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import observations_by_picture
from gaussray.runtime.output import first_of


# Signs of which so many make motion doubtful: a drive straight ahead has one, its focal length.
_SIGNS = 2
# Share of the matches of two pictures that stays where it is, which motion does not explain. Of a
# camera whose view has changed within half of its video, hardly a thousandth stays by chance.
_STAYING = 0.05


def doubtful_motion_findings(placement: Placement) -> list[Finding]:
    """A warning if the pictures do not tell whether cameras stand still, and what was estimated as
    their motion is doubtful: of a camera on a tripod it is the motion of what it shows.

    Signs are weak poses, an undetermined focal length, and matches that stay in place.

    Args:
        placement: estimated poses and matches of cameras that are taken to move.
    """
    if not placement.rig_untold or not placement.model.pictures:
        return []
    signs = []
    if placement.model.focal_source == "guess":
        signs.append("the pictures do not tell the focal length")
    counts = observations_by_picture(placement.model)
    weak = int(np.sum(counts < OBSERVATIONS))
    if 2 * weak > len(counts):
        signs.append(f"{weak} of {len(counts)} poses are weak")
    staying = _staying_share(placement)
    if staying > _STAYING:
        signs.append(
            f"between pictures apart in time, {100 * staying:.0f} % of the matches stay in place"
        )
    if len(signs) < _SIGNS:
        return []
    names = list(dict.fromkeys(picture.camera for picture in placement.pictures.values()))
    subject = "the camera stands" if len(names) == 1 else "the cameras stand"
    text = (
        f"{first_of(names)}: the pictures do not tell whether {subject} still, and the motion that "
        f"was estimated is doubtful ({'; '.join(signs)})"
    )
    remedy = f"{standing_advice(placement)} If not, poses.rig=moving says so."
    return [Finding("warn", "cameras", text, remedy)]


def standing_advice(placement: Placement) -> str:
    """What to do if cameras stand still of which the pictures do not tell it: a sentence."""
    if len({picture.camera for picture in placement.pictures.values()}) > 1:
        return "If the cameras stand still, set poses.rig=still."
    return "If the camera stands still, other cameras must show its pose: add their videos."


def _staying_share(placement: Placement) -> float:
    """The share of matches at the same place in two pictures of one camera, the median of the pairs
    that are farthest apart in time, half of all; 0 of none."""
    gaps, shares = [], []
    for (a, b), rows in placement.matches.items():
        first, second = placement.pictures[a], placement.pictures[b]
        if first.camera == second.camera and len(rows):
            keypoints = placement.keypoints[a], placement.keypoints[b]
            stays = at_same_place(*keypoints, rows, (first.size, second.size))
            gaps.append(abs(first.instant - second.instant))
            shares.append(float(np.mean(stays)))
    if not gaps:
        return 0.0
    return float(np.median(np.array(shares)[np.array(gaps) >= np.median(gaps)]))
