"""Signals of silent videos: how much of the picture changes from frame to frame."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from gaussray.capture.video_file import decoded_frames
from gaussray.prepare.correlation import normalised_correlation
from gaussray.prepare.sources import Source, check_frames


# Longer side of the pictures that are compared, in pixels.
_SIDE = 160
# Samples per second of the common signal, and how many of them are independent.
MOTION_RATE = 120.0
_INDEPENDENT = 8.0
# Slow changes, over more seconds than this, are light and not motion.
_SLOW = 2.0


def motion_energy(
    source: Source, on_frame: Callable[[], None] = lambda: None
) -> Float[np.ndarray, " frames"]:
    """Mean absolute change of grey levels from the frame before, for each frame of a video.

    Key frames of a codec and frames that are repeated stand out for one frame: a median over three
    frames removes them.

    Args:
        source: the video.
        on_frame: called after each frame that is decoded.

    Raises:
        PrepareError: the video has more or fewer frames than times.
    """
    before, energy = None, []
    for frame in decoded_frames(source.path):
        scale = _SIDE / max(frame.width, frame.height)
        size = max(round(frame.width * scale), 1), max(round(frame.height * scale), 1)
        small = frame.reformat(*size, format="gray8").to_ndarray().astype(np.float32)
        energy.append(0.0 if before is None else float(np.abs(small - before).mean()))
        before = small
        on_frame()
    check_frames(source, len(energy))
    values = np.array(energy)
    values[:1] = values[1:2]
    return median_filter(values, 3, mode="nearest")


def motion_signal(
    times: Float[np.ndarray, " frames"], energy: Float[np.ndarray, " frames"]
) -> Float[np.ndarray, " samples"]:
    """The logarithm of the energy at `MOTION_RATE`, without slow changes, of unit variance.

    Args:
        times: seconds of each frame on the camera's own clock; the first is that of sample 0.
        energy: change of grey levels of each frame (`motion_energy`).
    """
    grid = np.arange(times[0], times[-1], 1 / MOTION_RATE)
    values = np.interp(grid, times, np.log(np.maximum(energy, 1e-3)))
    width = max(int(_SLOW * MOTION_RATE), 1)
    if len(values) > width:
        pad = np.pad(values, width // 2, mode="reflect")
        slow = np.convolve(pad, np.full(width, 1 / width), "same")[width // 2 :][: len(values)]
        values = values - slow
    values = values - values.mean()
    return values / max(float(values.std()), 1e-9)


def motion_scores(
    first: Float[np.ndarray, " n"], second: Float[np.ndarray, " m"], most: int
) -> tuple[Float[np.ndarray, " lags"], Float[np.ndarray, " lags"]]:
    """Correlation coefficients of two signals, and their significance, at lags -most ... most.

    The significance is Fisher's: atanh(r) times the root of the number of independent samples that
    overlap, so that a high coefficient of a short overlap counts little. Both are 0 where too
    little overlaps (`normalised_correlation`).

    Args:
        first: signal of the first video (`motion_signal`).
        second: signal of the second one.
        most: largest lag in either direction, in samples at `MOTION_RATE`.
    """
    coefficients, scores = np.zeros(2 * most + 1), np.zeros(2 * most + 1)
    lags, values = normalised_correlation(first, second, most)
    if len(lags):
        overlap = np.minimum(len(first), len(second) + lags) - np.maximum(lags, 0)
        coefficients[lags + most] = values
        scores[lags + most] = np.arctanh(np.clip(values, -0.999, 0.999)) * np.sqrt(
            overlap / MOTION_RATE * _INDEPENDENT
        )
    return coefficients, scores
