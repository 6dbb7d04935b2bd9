"""Estimated poses that the matches contradict: of single pictures, and between two of them."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from gaussray.prepare.findings.pair_distances import (
    PairDistance,
    pair_distances,
    pairs_with_enough_matches,
)
from gaussray.prepare.placement import Placement


# Distances of pairs of pictures, in thousandths of the width.
StrongPairs = Mapping[tuple[str, str], PairDistance]


class Evidence(NamedTuple):
    """What it takes to call a pose wrong: how many thousandths of the width its matches are off,
    and how many pairs among how many other pictures fit."""

    distance: float
    pairs: int = 1
    pictures: int = 2


DOUBTFUL = Evidence(1.0)
# Blurred pictures, and near duplicates beside them, differ as well.
SURE = Evidence(3.0, 3, 3)
# Matches contradict a pose if they are so many times as far off as the others. (Of the captures
# that were looked at, pictures whose pose was right reached 2.7 times, and wrong ones 7.7 and 192
# times.)
_FARTHER = 4.0
# Pairs of a picture that count: those with most matches.
_PARTNERS = 12
# Fewest matches of a picture that has one pair alone, and of a pair that contradicts by itself:
# repeated textures give some dozens that agree with each other.
_ALONE = 100


def contradicted_pictures(
    placement: Placement, pairs: StrongPairs, evidence: Evidence
) -> dict[str, tuple[float, float]]:
    """Pictures whose matches are far off while those of the others fit: by file their typical
    distance in pixels of that picture, and that of the pairs without it.

    One after another, the picture that is farthest off in proportion is taken out. Of a pair that
    is off by itself nothing tells which of both is wrong (`contradicting_pairs`).

    Args:
        placement: poses, lenses, keypoints and matches.
        pairs: distances of the pairs that count (`strong_pairs`).
        evidence: how much of it a picture needs.
    """
    left, widths = pairs, _widths(placement)
    found: dict[str, tuple[float, float]] = {}
    while 2 * (len(found) + 1) < len(placement.model.pictures):
        distances = _distances(left, evidence)
        if not distances:
            break
        worst = max(distances, key=lambda file: distances[file][0] / max(distances[file][1], 1e-9))
        own, rest = distances[worst]
        if not _is_far(own, rest, evidence):
            break
        scale = widths[worst] / 1000
        found[worst] = scale * own, scale * rest
        left = {pair: one for pair, one in left.items() if worst not in pair}
    return found


def contradicting_pairs(placement: Placement, pairs: StrongPairs) -> dict[tuple[str, str], float]:
    """Pairs that are far off although one of both pictures shares most matches with the other, and
    how far, in pixels of the second picture.

    Args:
        placement: poses, lenses, keypoints and matches.
        pairs: distances of the pairs that count (`strong_pairs`).
    """
    widths = _widths(placement)
    most = {
        file: max(one.matches for pair, one in pairs.items() if file in pair)
        for file in {file for pair in pairs for file in pair}
    }
    typical = _typical(pairs.values())
    return {
        pair: one.median * widths[pair[1]] / 1000
        for pair, one in pairs.items()
        if _is_far(one.median, typical)
        and one.matches >= max(_ALONE, min(most[file] for file in pair))
    }


def _is_far(distance: float, others: float, evidence: Evidence = DOUBTFUL) -> bool:
    return distance > max(evidence.distance, _FARTHER * others)


def _widths(placement: Placement) -> dict[str, int]:
    """The width in pixels of each registered picture."""
    return {file: placement.pictures[file].size[0] for file in placement.model.pictures}


def strong_pairs(placement: Placement) -> StrongPairs:
    """Of each picture the pairs with most matches, with distances in thousandths of the width, so
    that pictures of several sizes compare.

    Args:
        placement: poses, lenses, keypoints and matches.
    """
    by_file: dict[str, list[tuple[str, str]]] = {}
    for pair in pairs_with_enough_matches(placement):
        for file in pair:
            by_file.setdefault(file, []).append(pair)
    chosen = dict.fromkeys(
        pair
        for own in by_file.values()
        for pair in sorted(own, key=lambda pair: -len(placement.matches[pair]))[:_PARTNERS]
    )
    widths = _widths(placement)
    return {
        pair: one._replace(median=1000 * one.median / widths[pair[1]])
        for pair, one in pair_distances(placement, chosen).items()
    }


def _distances(pairs: StrongPairs, evidence: Evidence) -> dict[str, tuple[float, float]]:
    """The typical distance of the pairs with each picture, and of those without it.

    Args:
        pairs: the pairs that count.
        evidence: how many those without it must be.
    """
    result = {}
    for file in dict.fromkeys(file for pair in pairs for file in pair):
        own = [one for pair, one in pairs.items() if file in pair]
        others = [pair for pair in pairs if file not in pair]
        pictures = {one for pair in others for one in pair}
        if len(others) < evidence.pairs or len(pictures) < evidence.pictures:
            continue
        rest = [pairs[pair] for pair in others]
        if len(own) > 1 or own[0].matches >= _ALONE:
            result[file] = _typical(own), _typical(rest)
    return result


def _typical(pairs: Iterable[PairDistance]) -> float:
    """Median distance of all matches, each as far off as its pair is; 0 of none."""
    ordered = sorted(pairs, key=lambda one: one.median)
    if not ordered:
        return 0.0
    counts = np.cumsum([one.matches for one in ordered])
    return ordered[int(np.searchsorted(counts, counts[-1] / 2))].median
