"""The size at which a machine has the time to fit the pictures of a capture."""

import math
from collections.abc import Sequence

from gaussray.capture.capture import View
from gaussray.capture.frames import visible_pixels
from gaussray.capture.spread import evenly_spread
from gaussray.capture.view_file import shown_size
from gaussray.reconstruct.auto.machine import Machine


# Pictures whose masks are looked at. However much masks hide, so large a share of the pixels
# counts: pictures are read, matched and measured whole.
_LOOKED_AT, _LEAST_SHARE = 8, 0.25


def pixel_count(views: Sequence[View]) -> float:
    """Number of pixels of views, without margins.

    Args:
        views: the views.
    """
    return float(sum(width * height for width, height in map(shown_size, views)))


def picture_scale(views: Sequence[View], machine: Machine, motion: str, longer: float) -> float:
    """The scale of the sides, at most 1, at which the machine has the time to see each pixel a few
    times.

    Of more times than motion is looked at in, so many count: a longer video of the same things is
    no reason for smaller pictures. Nor do pixels that masks hide count.

    Args:
        views: the training views, as large as they were given.
        machine: what the steps will run on.
        motion: what shows motion (`fit.motion`); "none" where nothing moves.
        longer: how many times as long as by default the fit takes; at least 1.
    """
    times = 1 if motion == "none" else len({view.time for view in views})
    pixels = pixel_count(views) * min(1.0, machine.instants / times)
    most = machine.most_pixels(motion) * longer
    if pixels <= most:
        return 1.0
    return min(1.0, math.sqrt(most / (pixels * _visible_share(views))))


def _visible_share(views: Sequence[View]) -> float:
    """About which share of the pixels counts, by a few masks."""
    if not any(view.mask is not None or view.background == "mask" for view in views):
        return 1.0
    chosen = evenly_spread(views, _LOOKED_AT)
    visible = sum(float(visible_pixels(view).sum()) for view in chosen)
    return max(visible / pixel_count(chosen), _LEAST_SHARE)
