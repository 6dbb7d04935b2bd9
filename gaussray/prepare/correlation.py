"""Delays between two signals, and how much they can be trusted."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


# A peak this many times as high as the next one is beyond doubt.
_CERTAIN = 2.0
# Signals that overlap by less than this share of the shorter one are not compared.
_OVERLAP = 0.4


class Delay(NamedTuple):
    """Seconds to be added to the second clock to match the first, and the confidence in 0..1."""

    seconds: float
    confidence: float


def confidence(
    values: Float[np.ndarray, " lags"], lags: Float[np.ndarray, " lags"], width: float | int | int
) -> float:
    """How far the highest peak stands above the highest value more than `width` seconds away: 0 if
    both are equal, 1 if it is `_CERTAIN` times as high."""
    best = int(values.argmax())
    away = np.abs(lags - lags[best]) > width
    other = float(values[away].max(initial=0)) if away.any() else 0.0
    peak = float(values[best])
    if peak <= 0:
        return 0.0
    return float(np.clip((peak / max(other, 1e-12) - 1) / (_CERTAIN - 1), 0, 1))


def normalised_correlation(
    first: Float[np.ndarray, " n"], second: Float[np.ndarray, " m"], most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Lags (samples, second shifted to the right by the lag) and correlation coefficients of the
    overlapping parts, in -1..1."""
    least = max(int(_OVERLAP * min(len(first), len(second))), 8)
    lags, values = [], []
    for lag in range(-most, most + 1):
        a, b = max(lag, 0), min(len(first), len(second) + lag)
        if b - a < least:
            continue
        x, y = first[a:b] - first[a:b].mean(), second[a - lag : b - lag]
        y = y - y.mean()
        norm = np.sqrt((x @ x) * (y @ y))
        lags.append(lag)
        values.append(float(x @ y / norm) if norm > 0 else 0.0)
    return np.array(lags, int), np.array(values)


def parabola_peak(values: Float[np.ndarray, " n"], best: int) -> float:
    """Position of the maximum between samples, from a parabola through three of them."""
    if not 0 < best < len(values) - 1:
        return float(best)
    a, b, c = values[best - 1 : best + 2]
    bend = a - 2 * b + c
    return best + (float(0.5 * (a - c) / bend) if bend < 0 else 0.0)
