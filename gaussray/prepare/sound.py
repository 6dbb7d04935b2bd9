"""Delays between sound tracks by generalised cross-correlation (Knapp and Carter 1976)."""

from pathlib import Path

import av
import numpy as np
from jaxtyping import Float

from gaussray.capture.video_file import open_video
from gaussray.prepare.correlation import Delay, confidence


# Samples per second, and the band that is compared: what all phones record of a room.
SOUND_RATE = 8000
_BAND = (100.0, 3400.0)
# Echoes of one sound arrive within this many seconds.
_ECHO = 0.05


def read_sound(path: Path) -> tuple[Float[np.ndarray, " samples"], float]:
    """The first sound track of a video, mono at `SOUND_RATE`, and the time of its first sample."""
    blocks, begin = [], 0.0
    with open_video(path, sound=True) as container:
        stream = container.streams.audio[0]
        resampler = av.AudioResampler(format="flt", layout="mono", rate=SOUND_RATE)
        for k, frame in enumerate(container.decode(stream)):
            if k == 0 and frame.pts is not None:
                begin = float(frame.pts * frame.time_base)
            blocks += [part.to_ndarray()[0] for part in resampler.resample(frame)]
        blocks += [part.to_ndarray()[0] for part in resampler.resample(None)]
    samples = np.concatenate(blocks) if blocks else np.zeros(0, np.float32)
    return samples.astype(np.float64), begin


def sound_delay(
    first: Float[np.ndarray, " n"], second: Float[np.ndarray, " m"], longest: float
) -> Delay:
    """Seconds that must be added to the second track's clock to match the first.

    The cross-power spectrum is whitened within the band of speech (phase transform), so that the
    peak is sharp however each microphone colours the sound.

    Args:
        first: mono samples of the first track at `SOUND_RATE`.
        second: mono samples of the second one.
        longest: largest delay in either direction, in seconds.
    """
    size = 1 << (len(first) + len(second)).bit_length()
    spectrum = np.fft.rfft(first, size) * np.conj(np.fft.rfft(second, size))
    frequency = np.fft.rfftfreq(size, 1 / SOUND_RATE)
    magnitude = np.abs(spectrum)
    inside = (frequency > _BAND[0]) & (frequency < _BAND[1]) & (magnitude > 0)
    whitened = np.where(inside, spectrum / np.where(magnitude > 0, magnitude, 1), 0)
    peaks = np.fft.irfft(whitened, size) * size / max(2 * int(inside.sum()), 1)
    most = min(round(longest * SOUND_RATE), len(first) - 1, len(second) - 1)
    if most < 1:
        return Delay(0.0, 0.0)
    lags = np.arange(-most, most + 1)
    values = np.abs(peaks[lags])
    best = int(values.argmax())
    # Noise has peaks too: the correlation must stand out of them.
    return Delay(lags[best] / SOUND_RATE, confidence(values, lags / SOUND_RATE, _ECHO))
