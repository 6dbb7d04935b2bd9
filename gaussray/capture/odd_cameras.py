"""Which cameras explain that some pairs of cameras contradict their poses and others do not."""

from collections.abc import Mapping
from typing import NamedTuple


# Of a pair alone the camera is wrong that fits elsewhere in fewer matches than the other one; the
# difference must be so large a share of the pair's matches.
_CLEARLY = 0.5


class JudgedPair(NamedTuple):
    """What the matches of two cameras say of their poses and lenses.

    Args:
        matches: number of matches.
        fits: whether they lie on their epipolar lines.
    """

    matches: int
    fits: bool


def odd_cameras(pairs: Mapping[tuple[str, str], JudgedPair], *, alone: int = 0) -> list[str]:
    """Names of few cameras without which all pairs fit; none if there are no such cameras, or if
    another one would explain a pair as well.

    One after another, the camera with the most matches that do not fit, less those that do, is
    taken out. It must have more of the former, and two pairs that do not fit; or one of at
    least `alone` matches, whose other camera fits elsewhere in clearly more matches than it. Most
    cameras must stay, and a pair that fits. A pair of fewer matches that is the only one of both
    its cameras that does not fit is left out.

    Args:
        pairs: pairs of cameras, by name.
        alone: fewest matches with which a pair alone shows that one of its cameras is wrong.
    """
    names = sorted({name for pair in pairs for name in pair})
    off = [name for pair, judged in pairs.items() if not judged.fits for name in pair]
    odd = []
    left = {
        pair: judged
        for pair, judged in pairs.items()
        if judged.fits or judged.matches >= alone or max(map(off.count, pair)) > 1
    }
    while not all(pair.fits for pair in left.values()):
        score = dict.fromkeys(names, 0)
        for pair, (matches, fits) in left.items():
            for name in pair:
                score[name] += -matches if fits else matches
        worst = max(names, key=lambda name: score[name])
        bad = [pair for pair, judged in left.items() if worst in pair and not judged.fits]
        if score[worst] <= 0:
            return []
        if len(bad) == 1:
            matches, apart = left[bad[0]].matches, abs(score[bad[0][0]] - score[bad[0][1]])
            if matches < alone or apart < _CLEARLY * matches:
                return []
        odd.append(worst)
        left = {pair: judged for pair, judged in left.items() if worst not in pair}
    return sorted(odd) if left and 2 * len(odd) < len(names) else []
