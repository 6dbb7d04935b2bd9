"""One clock for all cameras: the offset of each, with its confidence."""

import dataclasses
import itertools
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gaussray.prepare.consensus import consensus
from gaussray.prepare.correlation import Delay
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.motion import MOTION_RATE, motion_energy, motion_scores, motion_signal
from gaussray.prepare.options import SyncOptions
from gaussray.prepare.sound import read_sound, sound_delay
from gaussray.prepare.sources import Source
from gaussray.runtime.progress import Progress


# Cameras are compared with so many of their neighbours in the list, not with all.
_NEIGHBOURS = 12
# Steps of the robust fit, and the residual in seconds that counts half.
_STEPS, _CAUCHY = 20, 0.02
# Motion that peaks within so many seconds of another peak is the same event.
_PEAK = 0.25
# A walk repeats itself each second: fewer seconds than this in common are trusted in proportion.
_LONG = 6.0
# Rates of videos of one recorder differ by a smaller share.
_SAME_RATE = 2e-3


@dataclasses.dataclass(frozen=True)
class Sync:
    """Seconds to be added to each camera's clock to get the common time.

    Args:
        method: how the offsets were found: sound, motion, sound and motion, known or none.
        offsets: seconds by camera; 0 for the first one.
        confidence: in 0..1 by camera, of the best comparison with another one.
        disagreement: largest difference in seconds between a pair's delay and the offsets, by
            camera, over the comparisons that were used.
        assumed: videos without a trusted offset, by whatever they were compared with: they are
            taken to start with the first camera.
    """

    method: str
    offsets: dict[str, float]
    confidence: dict[str, float]
    disagreement: dict[str, float]
    assumed: frozenset[str] = frozenset()


def synchronise(sources: Sequence[Source], options: SyncOptions) -> Sync:
    """The offsets of the cameras' clocks.

    Args:
        sources: cameras of the input; the first one's clock is the reference.
        options: method, known offsets, longest offset and least confidence. A video whose
            confidence is below `trust` is taken to start together with the first one.

    Raises:
        PrepareError: `sync.offsets` does not have a number for each camera, or sound is demanded of
            videos that have none.
    """
    names = [source.name for source in sources]
    if options.offsets:
        if len(options.offsets) != len(sources):
            raise PrepareError(
                f"sync.offsets must have a number for each of the {len(sources)} cameras "
                f"({', '.join(names)}), got {len(options.offsets)}."
            )
        offsets = dict(zip(names, map(float, options.offsets), strict=True))
        return Sync("known", offsets, dict.fromkeys(names, 1.0), dict.fromkeys(names, 0.0))
    videos = [source for source in sources if source.is_video]
    _check_sound(videos, options)
    # A single frame shows no motion, and its sound lasts no longer than it.
    momentary = any(source.count < 2 for source in videos)
    if options.method == "none" or len(videos) < 2 or momentary:
        return _together(sources, "none")
    method, found = _estimated(videos, options)
    offsets, confidence = starts_together(sources), dict.fromkeys(names, 0.0)
    disagreement = dict.fromkeys(names, 0.0)
    for k, source in enumerate(videos):
        confidence[source.name] = float(found.confidence[k])
        if np.isfinite(found.offsets[k]):
            offsets[source.name] = float(found.offsets[k])
            disagreement[source.name] = float(found.disagreement[k])
    placed = np.isfinite(found.offsets)
    assumed = frozenset(s.name for s, one in zip(videos, placed, strict=True) if not one)
    return Sync(method, offsets, confidence, disagreement, assumed)


def starts_together(sources: Sequence[Source]) -> dict[str, float]:
    """Offsets for which the first frames of all cameras have one time."""
    begin = {s.name: float(s.times[0]) if len(s.times) else 0.0 for s in sources}
    first = begin[sources[0].name]
    return {name: first - time for name, time in begin.items()}


class Estimate(NamedTuple):
    """Offsets of videos in seconds (NaN where they are not trusted), their confidence, and the
    disagreement of pairs with them."""

    offsets: np.ndarray
    confidence: np.ndarray
    disagreement: np.ndarray


def solve_offsets(
    count: int, pairs: Sequence[tuple[int, int, Delay]], trust: float, reference: int = 0
) -> Estimate:
    """Offsets that fit the delays of pairs of videos, robustly.

    Least squares weighted by confidence, reweighted by the residuals (Cauchy, 20 ms).

    Args:
        count: number of videos.
        pairs: (i, j, delay) of compared videos: clock j plus the delay is clock i.
        trust: least confidence of a delay that is used; videos that no such pair links with the
            reference, and a reference that none links with another video, have offset NaN.
        reference: video whose offset is 0.
    """
    used = [pair for pair in pairs if pair[2].confidence >= trust]
    linked = {reference}
    for _ in range(count):
        linked |= {b for i, j, _ in used for a, b in ((i, j), (j, i)) if a in linked}
    offsets, best, worst = np.full(count, np.nan), np.zeros(count), np.zeros(count)
    for i, j, delay in pairs:
        best[[i, j]] = np.maximum(best[[i, j]], delay.confidence)
    used = [pair for pair in used if pair[0] in linked]
    rows, target = np.zeros((len(used) + 1, count)), np.zeros(len(used) + 1)
    base = np.ones(len(used) + 1)
    for k, (i, j, delay) in enumerate(used):
        rows[k, j], rows[k, i], target[k], base[k] = 1.0, -1.0, delay.seconds, delay.confidence
    rows[-1, reference], weight, found, residual = 1.0, base.copy(), np.zeros(count), np.zeros(0)
    for _ in range(_STEPS):
        found = np.linalg.lstsq(rows * weight[:, None], target * weight, rcond=None)[0]
        residual = rows @ found - target
        weight = base / np.sqrt(1 + (residual / _CAUCHY) ** 2)
    for k, (i, j, _) in enumerate(used):
        worst[[i, j]] = np.maximum(worst[[i, j]], abs(residual[k]))
        offsets[[i, j]] = found[[i, j]]
    return Estimate(offsets, best, worst)


def _check_sound(videos: Sequence[Source], options: SyncOptions) -> None:
    silent = [source.name for source in videos if not source.has_sound]
    if options.method == "sound" and silent:
        raise PrepareError(
            f"sync.method must be motion, none or auto for videos without sound, got sound and "
            f"{', '.join(silent)}."
        )


def _together(sources: Sequence[Source], method: str) -> Sync:
    zeros = dict.fromkeys((source.name for source in sources), 0.0)
    return Sync(method, starts_together(sources), zeros, zeros)


def _estimated(videos: Sequence[Source], options: SyncOptions) -> tuple[str, Estimate]:
    """How the offsets were found, and the offsets. By default sound decides, and motion for the
    videos that it does not link: those without sound, or with a track that tells nothing."""
    if options.method == "motion":
        return "motion", _by_motion(videos, options)
    pairs = _sound_delays(videos, options)
    if options.method == "sound":
        return "sound", solve_offsets(len(videos), pairs, options.trust)
    surest = max(pairs, key=lambda pair: pair[2].confidence, default=None)
    if surest is None or surest[2].confidence < options.trust:
        return "motion", _by_motion(videos, options)
    sound = solve_offsets(len(videos), pairs, options.trust, surest[0])
    if np.isfinite(sound.offsets).all():
        return "sound", sound._replace(offsets=sound.offsets - sound.offsets[0])
    together = np.array(list(starts_together(videos).values()))
    return "sound and motion", join_estimates(sound, _by_motion(videos, options), together)


def join_estimates(
    sound: Estimate, motion: Estimate, together: Float[np.ndarray, " videos"]
) -> Estimate:
    """The offsets of sound where there are any, and of motion for the other videos.

    Args:
        sound: offsets against some video, NaN for those that sound does not link with it.
        motion: offsets against video 0, NaN where they are not trusted.
        together: offsets for which all videos start with video 0. Without motion, the first of the
            videos with sound is placed by it.
    """
    linked = np.isfinite(sound.offsets)
    both = linked & np.isfinite(motion.offsets)
    if both.any():
        shift = np.median((motion.offsets - sound.offsets)[both])
    else:
        shift = (together - sound.offsets)[linked][0]
    offsets = np.where(linked, sound.offsets + shift, motion.offsets)
    return Estimate(
        offsets - (offsets[0] if np.isfinite(offsets[0]) else 0.0),
        np.where(linked, sound.confidence, motion.confidence),
        np.where(linked, sound.disagreement, motion.disagreement),
    )


def _sound_delays(videos: Sequence[Source], options: SyncOptions) -> list[tuple[int, int, Delay]]:
    """Delays of the pairs of videos that have sound."""
    tracks = {k: read_sound(source.path) for k, source in enumerate(videos) if source.has_sound}
    pairs = []
    for i, j in combinations(tracks, 2):
        if j - i > _NEIGHBOURS and i > 0:
            continue
        (first, begin), (second, other) = tracks[i], tracks[j]
        delay = sound_delay(first, second, options.longest)
        pairs.append((i, j, Delay(delay.seconds + begin - other, delay.confidence)))
    return pairs


def _by_motion(videos: Sequence[Source], options: SyncOptions) -> Estimate:
    """Signals begin at each video's first frame; the offsets of the clocks are counted from it."""
    done, total = itertools.count(1), sum(source.count for source in videos)
    progress = Progress("synchronising", total, patience=2.0)
    signals = [
        motion_signal(source.times, motion_energy(source, lambda: progress.report(next(done))))
        for source in videos
    ]
    most, count = round(options.longest * MOTION_RATE), len(videos)
    curves = {
        (i, j): motion_scores(signals[i], signals[j], most)
        for i, j in combinations(range(count), 2)
    }
    scores = {pair: score for pair, (_, score) in curves.items()}
    found = consensus(scores, count, [0.0] * count, round(_PEAK * MOTION_RATE))
    likeness = np.zeros(count)
    for (i, j), (coefficients, _) in curves.items():
        lag = round(found.offsets[j] - found.offsets[i]) + most
        value = float(coefficients[lag]) if 0 <= lag < len(coefficients) else 0.0
        likeness[[i, j]] = np.maximum(likeness[[i, j]], value)
    shared = _shared_seconds(signals, found.offsets)
    confidence = found.contrast * np.clip(likeness, 0, 1) * np.clip(shared / _LONG, 0, 1)
    trusted = (confidence >= options.trust).copy()
    # The first camera's own offset is 0: what it cannot be compared with is not known either.
    trusted &= trusted[0]
    late = np.where(trusted, found.offsets / MOTION_RATE, np.nan)
    rates = np.array([source.rate for source in videos])
    counts = np.array([source.count for source in videos])
    for number, rate in {(source.count, source.rate) for source in videos}:
        alike = trusted & (counts == number) & np.isclose(rates, rate, rtol=_SAME_RATE)
        if is_one_recording(late[alike], rate):
            late[alike] = 0 if alike[0] else np.median(late[alike])
    begin = np.array([source.times[0] for source in videos])
    return Estimate(late + begin[0] - begin, confidence, np.zeros(count))


def is_one_recording(offsets: Float[np.ndarray, " alike"], rate: float) -> bool:
    """Whether videos of equally many frames at one rate are of one recorder that starts and ends
    all cameras: less than a frame lies between their starts. Motion tells no shorter times: of a
    man before four cameras at 6 frames a second it finds 0.12 s where there are at most 0.02.

    Args:
        offsets: seconds by which the first frame of each is late, as motion tells them, of those
            for which it is trusted.
        rate: frames per second of these videos.
    """
    return len(offsets) > 1 and float(np.ptp(offsets)) * rate < 1


def _shared_seconds(signals: Sequence[np.ndarray], offsets: np.ndarray) -> np.ndarray:
    """Seconds that each signal shares with the others together."""
    begin, end = offsets, offsets + np.array([len(signal) for signal in signals])
    shared = np.minimum(end[:, None], end) - np.maximum(begin[:, None], begin)
    np.fill_diagonal(shared, 0)
    return np.maximum(shared, 0).max(axis=1) / MOTION_RATE
