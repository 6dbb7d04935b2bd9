"""How far the matches of all pairs of pictures lie from their epipolar lines."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from gaussray.prepare.epipolar import epipolar_distance
from gaussray.prepare.placement import Placement


# Fewest matches of a pair that count: wide baselines give some twenty that are all wrong.
EVIDENCE = 40


class PairDistance(NamedTuple):
    """The matches of two pictures.

    Args:
        matches: number of matches.
        median: median distance from the epipolar lines in pixels.
    """

    matches: int
    median: float


def pairs_with_enough_matches(placement: Placement) -> list[tuple[str, str]]:
    """Pairs of files of registered pictures that share enough matches to tell something."""
    registered = set(placement.model.pictures)
    return [
        pair
        for pair, rows in placement.matches.items()
        if len(rows) >= EVIDENCE and registered.issuperset(pair)
    ]


def pair_distances(
    placement: Placement, pairs: Iterable[tuple[str, str]]
) -> dict[tuple[str, str], PairDistance]:
    """Distances of the matches from their epipolar lines, for each pair.

    Args:
        placement: poses, lenses, keypoints and matches.
        pairs: pairs of files; those whose lenses have no ray at any match are left out.
    """
    index = {name: k for k, name in enumerate(placement.model.pictures)}
    found = {}
    for first, second in pairs:
        distance = epipolar_distance(placement, first, second, index)
        distance = distance[np.isfinite(distance)]
        if len(distance):
            found[first, second] = PairDistance(len(distance), float(np.median(distance)))
    return found


def typical_distance(distances: Iterable[PairDistance]) -> float:
    """Median over the pairs, in pixels; infinite if there are none."""
    medians = [pair.median for pair in distances]
    return float(np.median(medians)) if medians else float("inf")
