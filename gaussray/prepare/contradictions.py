"""Estimated poses that the matches contradict: of single pictures, and between two of them."""

from collections.abc import Iterable, Mapping

import numpy as np

from gaussray.prepare.findings.pair_distances import PairDistance, pair_distances, telling_pairs
from gaussray.prepare.poses import Placement


# Matches contradict a pose if they are so many times as far off as the others, and so many
# thousandths of the width. (Of the captures that were looked at, pictures whose pose was right
# reached 2.7 times, and wrong ones 7.7 and 192 times.)
_FARTHER, _LEAST = 4.0, 1.0
# A pose is surely wrong only if matches are so many thousandths of the width off, and the others
# are so many pairs among so many pictures: blurred pictures and near duplicates beside them differ
# as well.
_SURELY, _SURE_PAIRS, _SURE_PICTURES = 3.0, 3, 3
# Pairs of a picture that count: those with most matches.
_PARTNERS = 12
# Fewest matches of a picture that has one pair alone, and of a pair that contradicts by itself:
# repeated textures give some dozens that agree with each other.
_ALONE = 100


def contradicted_pictures(
    placement: Placement, *, surely: bool = False
) -> dict[str, tuple[float, float]]:
    """Pictures whose matches are far off while those of the others fit: by file their typical
    distance in pixels of that picture, and that of the pairs without it.

    One after another, the picture that is farthest off in proportion is taken out. Of a pair that
    is off by itself nothing tells which of both is wrong (`contradicting_pairs`).

    Args:
        placement: poses, lenses, keypoints and matches.
        surely: only those whose pose cannot be right, beside enough others that tell it; else all
            that are doubtful.
    """
    left, least = _strong_pairs(placement), _SURELY if surely else _LEAST
    found: dict[str, tuple[float, float]] = {}
    while 2 * (len(found) + 1) < len(placement.model.pictures):
        distances = _distances(left, surely)
        if not distances:
            break
        worst = max(distances, key=lambda file: distances[file][0] / max(distances[file][1], 1e-9))
        own, rest = distances[worst]
        if not _is_far(own, rest, least):
            break
        scale = _widths(placement)[worst] / 1000
        found[worst] = scale * own, scale * rest
        left = {pair: one for pair, one in left.items() if worst not in pair}
    return found


def contradicting_pairs(placement: Placement) -> dict[tuple[str, str], float]:
    """Pairs that are far off although one of both pictures shares most matches with the other, and
    how far, in pixels of the second picture.

    Args:
        placement: poses, lenses, keypoints and matches.
    """
    pairs, widths = _strong_pairs(placement), _widths(placement)
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


def _is_far(distance: float, others: float, least: float = _LEAST) -> bool:
    return distance > max(least, _FARTHER * others)


def _widths(placement: Placement) -> dict[str, int]:
    """The width in pixels of each registered picture."""
    return {file: placement.pictures[file].size[0] for file in placement.model.pictures}


def _strong_pairs(placement: Placement) -> dict[tuple[str, str], PairDistance]:
    """Of each picture the pairs with most matches, with distances in thousandths of the width, so
    that pictures of several sizes compare."""
    by_file: dict[str, list[tuple[str, str]]] = {}
    for pair in telling_pairs(placement):
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


def _distances(
    pairs: Mapping[tuple[str, str], PairDistance], surely: bool
) -> dict[str, tuple[float, float]]:
    """The typical distance of the pairs with each picture, and of those without it.

    Args:
        pairs: the pairs that count.
        surely: whether those without it must be enough.
    """
    result = {}
    for file in dict.fromkeys(file for pair in pairs for file in pair):
        own = [one for pair, one in pairs.items() if file in pair]
        others = [pair for pair in pairs if file not in pair]
        pictures = {one for pair in others for one in pair}
        if surely and (len(others) < _SURE_PAIRS or len(pictures) < _SURE_PICTURES):
            continue
        rest = [pairs[pair] for pair in others]
        if rest and (len(own) > 1 or own[0].matches >= _ALONE):
            result[file] = _typical(own), _typical(rest)
    return result


def _typical(pairs: Iterable[PairDistance]) -> float:
    """Median distance of all matches, each as far off as its pair is; 0 of none."""
    ordered = sorted(pairs, key=lambda one: one.median)
    if not ordered:
        return 0.0
    counts = np.cumsum([one.matches for one in ordered])
    return ordered[int(np.searchsorted(counts, counts[-1] / 2))].median
