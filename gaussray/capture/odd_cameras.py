"""Which cameras explain that some pairs of cameras contradict their poses and others do not."""

from collections.abc import Mapping
from typing import NamedTuple


# One camera has clearly more matches that do not fit than another if the difference is so large a
# share of those of the pair of both (a guess).
_CLEARLY = 0.5
# Matches with which one pair alone shows that one of its cameras is wrong: repeated textures give
# some dozens that agree with each other (experiments/captures/log.md).
_ALONE = 100


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
    others would explain a pair about as well.

    One after another, the camera with the most matches that do not fit, less those that do, is
    taken out, if

    * it has more of the former, and clearly more than the other camera of each such pair has,
      unless that one is taken out, too;
    * it has two pairs that do not fit, or one of at least _ALONE matches;
    * most cameras stay, and a pair that fits.

    A pair of fewer matches than that counts only if one of its cameras has another one that does
    not fit.

    Args:
        pairs: pairs of cameras, by name.
    """
    names = sorted({name for pair in pairs for name in pair})
    off = [name for pair, judged in pairs.items() if not judged.fits for name in pair]
    odd, rivals = [], set[str]()
    left = {
        pair: judged
        for pair, judged in pairs.items()
        if judged.fits or judged.matches >= _ALONE or max(map(off.count, pair)) > 1
    }
    while not all(pair.fits for pair in left.values()):
        score = dict.fromkeys(names, 0)
        for pair, (matches, fits) in left.items():
            for name in pair:
                score[name] += -matches if fits else matches
        worst = max(names, key=lambda name: score[name])
        bad = [pair for pair, judged in left.items() if worst in pair and not judged.fits]
        fewest = _ALONE if len(bad) == 1 else 0
        if score[worst] <= 0 or max(left[pair].matches for pair in bad) < fewest:
            return []
        rivals |= {
            name
            for pair in bad
            for name in pair
            if name != worst and score[worst] - score[name] < _CLEARLY * left[pair].matches
        }
        odd.append(worst)
        left = {pair: judged for pair, judged in left.items() if worst not in pair}
    told = left and 2 * len(odd) < len(names) and rivals <= set(odd)
    return sorted(odd) if told else []
