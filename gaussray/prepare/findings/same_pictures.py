"""Whether two cameras show the same pictures: a video and its copy."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from gaussray.capture.picture_file import read_levels
from gaussray.capture.spread import evenly_spread
from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.findings.pair_distances import EVIDENCE
from gaussray.prepare.low_resolution import details_differ, low_details
from gaussray.prepare.overlays import WITHOUT_IT, at_same_place, drawn_over_both, overlays_text
from gaussray.prepare.placement import Placement


# Such a share of the matches of the same pictures is at the same place in both. (Those of a stereo
# pair on a car are 0.01 to 0.1 of the width apart; most of them may be of a background so far away
# that they are at the same place.)
_SAME_MATCHES = 0.9
# Share of the common timestamps at which cameras of the same video show the same picture.
_SAME_TIMES = 0.8
# So many of these timestamps are compared at low resolution.
_COMPARED = 5


def same_picture_findings(
    placement: Placement, files: Mapping[str, Sequence[Path]]
) -> list[Finding]:
    """A warning for every two cameras that show the same pictures at nearly all timestamps, of
    whatever size; or of which a logo over different pictures alone is the same.

    Args:
        placement: keypoints and matches, and overlays that were left out of them.
        files: for each camera the file of each timestamp.
    """

    @cache
    def details(picture: MatchingPicture) -> np.ndarray:
        return low_details(read_levels(files[picture.camera][picture.instant], *picture.size))

    findings = []
    if placement.overlays:
        text = f"{overlays_text(placement.overlays)}; these matches are not used"
        findings.append(Finding("warn", "cameras", text, WITHOUT_IT))
    same: dict[tuple[str, str], list[bool]] = {}
    shots: dict[tuple[str, str], list[tuple[MatchingPicture, MatchingPicture]]] = {}
    for files_of_pair, rows in placement.matches.items():
        first, second = (placement.pictures[file] for file in files_of_pair)
        if first.camera == second.camera or first.instant != second.instant:
            continue
        if len(rows) < EVIDENCE:
            continue
        a, b = (placement.keypoints[file] for file in files_of_pair)
        stays = at_same_place(a, b, rows, (first.size, second.size))
        names = sorted((first.camera, second.camera))
        pair = names[0], names[1]
        is_same = bool(np.mean(stays) >= _SAME_MATCHES)
        same.setdefault(pair, []).append(is_same)
        if is_same:
            shots.setdefault(pair, []).append((first, second))
    for (a, b), shown in same.items():
        if sum(shown) < _SAME_TIMES * len(shown):
            continue
        if _differ(shots[a, b], details):
            text = f"{drawn_over_both(a, b)}, or a background too far away"
            remedy = f"{WITHOUT_IT} Of a far background: move the cameras farther apart."
        else:
            text = f"{a} and {b} show the same pictures{_times(shown)}, as a video and its copy do"
            remedy = "Leave one of them out: it adds nothing to the other."
        findings.append(Finding("warn", "cameras", text, remedy))
    return findings


def _differ(
    shots: Sequence[tuple[MatchingPicture, MatchingPicture]],
    details: Callable[[MatchingPicture], np.ndarray],
) -> bool:
    """Whether most of a few pairs of pictures differ at low resolution (`details`)."""
    compared = [
        details_differ(details(first), details(second))
        for first, second in evenly_spread(shots, _COMPARED)
    ]
    return 2 * sum(compared) > len(compared)


def _times(shown: list[bool]) -> str:
    return f" at {sum(shown)} of {len(shown)} timestamps" if len(shown) > 1 else ""
