"""Worlds whose origin is far away, as that of map coordinates is: read from a place nearby."""

import math
import warnings
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureWarning
from gaussray.capture.world_origin import MAP_COORDINATE, counted_from


# How finely numbers of 32 bits must tell positions, in standard deviations of those of the cameras.
_FINEST = 1e-4


def read_near_origin(read: Callable[[], Capture]) -> Capture:
    """A capture whose positions numbers of 32 bits tell apart.

    Near 5,000,000 (metres in map coordinates) they are half a metre apart. So where cameras are
    further from the origin than `MAP_COORDINATE`, and closer together than ten thousand such steps,
    the capture is read once more, with all positions counted from a round place among the cameras,
    with a warning that names it.

    Args:
        read: reads the capture; its positions go through `world_origin.counted_positions`.
    """
    capture = read()
    origin = _place_among_cameras(capture)
    if origin is None:
        return capture
    position = ", ".join(f"{x:.10g}" for x in origin)
    warnings.warn(
        f"{capture.folder}: the world's origin is so far from the cameras that numbers of 32 bits "
        f"do not tell their positions apart. All positions are counted from ({position}): add it "
        "to those of what is exported.",
        CaptureWarning,
        stacklevel=3,
    )
    with counted_from(origin), warnings.catch_warnings():
        # What there is to say has been said.
        warnings.simplefilter("ignore", CaptureWarning)
        return read()


def _place_among_cameras(capture: Capture) -> Float[np.ndarray, "3"] | None:
    """A round place among the cameras; None where the origin is near enough."""
    views = capture.all_views
    if not views:
        return None
    eye = np.concatenate([np.asarray(view.camera.trajectory.translation) for view in views])
    largest = np.abs(eye).max()
    finest, eye = float(np.spacing(largest)), eye.astype(np.float64)
    spread = float(np.sqrt(np.sum(np.var(eye, axis=0))))
    # Cameras that hardly move are close together wherever the origin is.
    if largest < MAP_COORDINATE or finest <= _FINEST * spread:
        return None
    # Round, so that other pictures of the same cameras are counted from the same place.
    step = 10.0 ** math.ceil(math.log10(max(10 * spread, 100 * finest)))
    return np.round(np.mean(eye, axis=0) / step) * step
