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
    values: Float[np.ndarray, " lags"], lags: Float[np.ndarray, " lags"], width: float | int
) -> float:
    """How far the highest peak stands above all values away from it, in 0..1.

    0 if the highest of these is as high as the peak, 1 if the peak is twice as high or more.

    Args:
        values: likeness of two signals at each lag.
        lags: lags, in seconds or samples.
        width: largest distance from the peak that still belongs to it, in the unit of `lags`.
    """
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
    """Lags and correlation coefficients, in -1..1, of the overlapping parts of two signals.

    At a lag, the sample i of `second` is compared with the sample i + lag of `first`. Lags at which
    less than 8 samples, or 40 % of the shorter signal, overlap are left out.

    Args:
        first: samples of the first signal, evenly spaced.
        second: samples of the second one at the same rate.
        most: largest lag in either direction, in samples.
    """
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
    """Position of the maximum between samples, from a parabola through three of them.

    Args:
        values: samples of a curve.
        best: index of the largest one; at either end of the curve it is the position itself.
    """
    if not 0 < best < len(values) - 1:
        return float(best)
    a, b, c = values[best - 1 : best + 2]
    bend = a - 2 * b + c
    return best + (float(0.5 * (a - c) / bend) if bend < 0 else 0.0)
