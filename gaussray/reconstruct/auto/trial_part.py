"""The part of a long capture that the fits of a trial see: successive times at which much moves.

What shows motion best does not depend on how long a capture is, but tracking does: rigid bodies
are searched for at every time. So a trial of hundreds of times would take longer than the fit.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from gaussray.capture.capture import Capture, View, viewpoints
from gaussray.capture.picture_stream import stream_encoded
from gaussray.capture.spread import evenly_spread
from gaussray.capture.temporal_median import differs
from gaussray.reconstruct.data.segments import training_views
from gaussray.runtime.progress import Progress


# Times that the fits of a trial see, of captures of more than twice as many: some more than the
# captures have on which trials were compared, 16 to 25 (experiments/captures/log.md).
TRIAL_TIMES = 30
# Stretches of time of which the liveliest is taken, and the cameras whose pictures tell, at most;
# of their pictures each so-manieth pixel of a row and a column counts.
_STRETCHES, _CAMERAS, _EVERY = 8, 3, 4


def trial_part(capture: Capture, *, quiet: bool = True) -> Capture:
    """The capture at TRIAL_TIMES successive times at which much moves; the whole capture if it has
    at most twice as many.

    Of up to _STRETCHES evenly spread stretches of time it is the one in which pictures of cameras
    that stand still change most.

    Args:
        capture: a capture, whose training views count.
        quiet: print no progress.
    """
    views = training_views(capture)
    times = np.unique([view.time for view in views])
    if len(times) <= 2 * TRIAL_TIMES:
        return capture
    count = min(_STRETCHES, len(times) // TRIAL_TIMES)
    starts = np.linspace(0, len(times) - TRIAL_TIMES, count).round().astype(int)
    parts = [times[start : start + TRIAL_TIMES] for start in starts]
    change, cameras = np.zeros(count), _still_views(views)
    bar = Progress("look for motion", len(cameras), quiet=quiet, patience=2.0)
    for done, own in enumerate(cameras, 1):
        change += _changes(own, parts)
        bar.report(done)
    first, *_, last = parts[int(np.argmax(change))]
    part = capture.with_views(lambda some: [view for view in some if first <= view.time <= last])
    return dataclasses.replace(part, time_range=(float(first), float(last)))


def _still_views(views: Sequence[View]) -> list[list[View]]:
    """The views of a few places at which cameras stand still, by time."""
    place = np.array(viewpoints(views))
    numbers, pictures = np.unique(place, return_counts=True)
    chosen = evenly_spread(numbers[pictures >= 3].tolist(), _CAMERAS)
    every = [[views[k] for k in np.flatnonzero(place == number).tolist()] for number in chosen]
    return [sorted(own, key=lambda view: view.time) for own in every]


def _changes(
    views: Sequence[View], parts: Sequence[Float[np.ndarray, " times"]]
) -> Float[np.ndarray, " parts"]:
    """The share of a camera's pixels that differ at the beginning, the middle and the end of each
    of several stretches of time."""
    times = np.array([view.time for view in views])
    wanted = np.array([(part[0], part[len(part) // 2], part[-1]) for part in parts])
    nearest = np.abs(times - wanted[..., None]).argmin(axis=-1)
    used = np.unique(nearest)
    # Alpha is dropped: what it hides does not change, and the fit tells of it.
    kind, pictures = stream_encoded(
        [dataclasses.replace(views[k], background="none") for k in used],
        lambda _, picture: picture[::_EVERY, ::_EVERY].copy(),
    )
    small = {int(used[index]): picture for index, picture in pictures}
    scale = 255 if kind == np.uint8 else 1

    def share(one: int, other: int) -> float:
        return float(differs(small[one], small[other], scale).mean())

    return np.array([share(a, b) + share(b, c) + share(a, c) for a, b, c in nearest.tolist()])
