"""Whether two cameras show the same pictures: a video and its copy."""

import numpy as np

from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.findings.pair_distances import EVIDENCE
from gaussray.prepare.poses import Placement


# Such a share of the matches of the same pictures is at the same place in both, but for so large a
# share of the width. (Those of a stereo pair on a car are 0.01 to 0.1 apart; most of them may be of
# a background so far away that they are at the same place.)
_SAME_MATCHES, _SAME_PLACE = 0.9, 0.002
# Share of the common timestamps at which cameras of the same video show the same picture.
_SAME_TIMES = 0.8


def same_picture_findings(placement: Placement) -> list[Finding]:
    """A warning for every two cameras that show the same pictures at nearly all timestamps, of
    whatever size."""
    same: dict[tuple[str, str], list[bool]] = {}
    for files, rows in placement.matches.items():
        first, second = (placement.pictures[file] for file in files)
        if first.camera == second.camera or first.instant != second.instant:
            continue
        if len(rows) < EVIDENCE:
            continue
        places = [
            placement.keypoints[file].xy[rows[:, k]] / placement.pictures[file].size
            for k, file in enumerate(files)
        ]
        distances = np.linalg.norm(places[1] - places[0], axis=1)
        apart = float(np.quantile(distances, _SAME_MATCHES))
        names = sorted((first.camera, second.camera))
        same.setdefault((names[0], names[1]), []).append(apart < _SAME_PLACE)
    return [
        Finding(
            "warn",
            "cameras",
            f"{a} and {b} show the same pictures{_times(shown)}, as a video and its copy do",
            "Leave one of them out: it adds nothing to the other.",
        )
        for (a, b), shown in same.items()
        if sum(shown) >= _SAME_TIMES * len(shown)
    ]


def _times(shown: list[bool]) -> str:
    return f" at {sum(shown)} of {len(shown)} timestamps" if len(shown) > 1 else ""
