"""Which cameras explain that some pairs of cameras contradict their poses and others do not."""

from collections.abc import Mapping
from typing import NamedTuple


class JudgedPair(NamedTuple):
    """What the matches of two cameras say of their poses and lenses.

    Args:
        matches: number of matches.
        fits: whether they lie on their epipolar lines.
    """

    matches: int
    fits: bool


def odd_cameras(pairs: Mapping[tuple[str, str], JudgedPair]) -> list[str]:
    """Names of few cameras without which all pairs fit; none if there are no such cameras, or if
    another one would explain a pair as well.

    One after another, the camera with the most matches that do not fit, less those that do, is
    taken out. It must have more of the former; most cameras must stay, and a pair that fits.

    Args:
        pairs: pairs of cameras, by name.
    """
    names = sorted({name for pair in pairs for name in pair})
    left, odd = dict(pairs), []
    while not all(pair.fits for pair in left.values()):
        score = dict.fromkeys(names, 0)
        for pair, (matches, fits) in left.items():
            for name in pair:
                score[name] += -matches if fits else matches
        worst = max(names, key=lambda name: score[name])
        bad = [pair for pair, judged in left.items() if worst in pair and not judged.fits]
        if score[worst] <= 0:
            return []
        if len(bad) == 1 and score[bad[0][0]] == score[bad[0][1]]:
            return []
        odd.append(worst)
        left = {pair: judged for pair, judged in left.items() if worst not in pair}
    return sorted(odd) if left and 2 * len(odd) < len(names) else []
