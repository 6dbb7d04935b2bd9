"""Offsets that all pairs of cameras agree on, from their correlations at every lag."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gaussray.prepare.correlation import confidence, parabola_peak


_SWEEPS = 6

# Scores of pairs (i, j), i < j, at lags -most ... most: lag is offset j minus offset i.
Scores = dict[tuple[int, int], np.ndarray]


class Consensus(NamedTuple):
    """Offsets in samples, the first one 0, and for each camera the contrast in 0..1 of its offset
    against the next best one."""

    offsets: Float[np.ndarray, " cameras"]
    contrast: Float[np.ndarray, " cameras"]


def consensus(scores: Scores, count: int, start: Sequence[float], width: int) -> Consensus:
    """The offsets with the largest sum of scores.

    Each camera in turn moves to the best lag against all others, from several starts: the given
    one, and the best lags against each camera. One pair may be wrong as long as others are right.

    Args:
        scores: scores of the pairs.
        count: number of cameras, at least two.
        start: offsets to start from, in samples.
        width: lags around a peak that count as the same peak.
    """
    most = (len(next(iter(scores.values()))) - 1) // 2
    starts = [np.round(np.asarray(start)).astype(int)]
    for hub in range(count):
        best = [0 if k == hub else int(_toward(scores, hub, k).argmax()) - most
                for k in range(count)]  # fmt: skip
        starts.append(np.array(best) - best[0])
    ends = [_climb(scores, count, np.clip(one, -most, most), most) for one in starts]
    offsets = max(ends, key=lambda one: _total(scores, one, most))
    refined, contrast = np.zeros(count), np.zeros(count)
    lags = np.arange(-most, most + 1)
    for k in range(count):
        sums = np.maximum(_sums(scores, count, k, offsets, most), 0)
        best = int(sums.argmax())
        refined[k] = lags[0] + parabola_peak(sums, best)
        contrast[k] = confidence(sums, lags.astype(float), width)
    return Consensus(refined - refined[0], contrast)


def _toward(scores: Scores, hub: int, camera: int) -> np.ndarray:
    """Scores of a camera's lag after the hub."""
    return scores[hub, camera] if hub < camera else scores[camera, hub][::-1]


def _sums(scores: Scores, count: int, camera: int, offsets: np.ndarray, most: int) -> np.ndarray:
    """Score of each offset of one camera, the others fixed; its lags are -most ... most."""
    total = np.zeros(2 * most + 1)
    for other in range(count):
        if other == camera:
            continue
        values, shift = _toward(scores, other, camera), int(offsets[other])
        a, b = max(shift, 0), min(2 * most + 1, 2 * most + 1 + shift)
        if a < b:
            total[a:b] += values[a - shift : b - shift]
    return total


def _climb(scores: Scores, count: int, offsets: np.ndarray, most: int) -> np.ndarray:
    offsets = offsets.copy()
    for _ in range(_SWEEPS):
        before = offsets.copy()
        for k in range(1, count):
            offsets[k] = int(_sums(scores, count, k, offsets, most).argmax()) - most
        if (offsets == before).all():
            break
    return offsets


def _total(scores: Scores, offsets: np.ndarray, most: int) -> float:
    lags = ((values, offsets[j] - offsets[i] + most) for (i, j), values in scores.items())
    return sum(float(values[lag]) for values, lag in lags if 0 <= lag < len(values))
