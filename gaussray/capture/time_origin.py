"""Timestamps far from 0, such as seconds since 1970, counted from the first."""

import dataclasses
import warnings

import numpy as np

from gaussray.camera.focus_pull import FocusPull
from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.io.plain_values import to_device


# How finely the numbers of cameras must tell times, in intervals between pictures: rows of a
# rolling shutter lie between them.
_FINEST = 1e-3


def with_times_from_first(capture: Capture) -> Capture:
    """The capture, with times that begin at 0 where the numbers of its cameras do not tell its own
    apart.

    Numbers of 32 bits near 1.7e9 (seconds since 1970) are 128 apart. So where the first time is
    further from 0 than from the last, and neighbouring times lie closer together than a thousand
    such steps, it is subtracted from all, with a warning.

    Args:
        capture: the capture; the views of its effects have times from the same origin.

    Raises:
        CaptureError: so it is, and poses or focus follow times of their own.
    """
    views = capture.all_views
    times = np.unique([view.time for view in views])
    first, span = capture.time_range[0], float(times[-1] - times[0])
    if len(times) < 2 or abs(first) <= span:
        return capture
    step = float(np.diff(times).min())
    finest = max(float(np.spacing(np.asarray(first, view.camera.time.dtype))) for view in views)
    if finest <= _FINEST * step:
        return capture
    problem = (
        f"{capture.folder}: times begin at {first:.10g} and are {step:.2g} apart, but cameras keep "
        f"times in 32 bits, which are {finest:.1g} apart there"
    )
    if any(_follows_times(view) for view in views):
        raise CaptureError(f"{problem}. Subtract the first time from all: time, trajectory, focus.")
    warnings.warn(f"{problem}: times are counted from the first one.", CaptureWarning, stacklevel=3)

    capture = capture.with_views(lambda views: [_counted_from(view, first) for view in views])
    return dataclasses.replace(capture, time_range=(0.0, capture.time_range[1] - first))


def _follows_times(view: View) -> bool:
    """Whether a camera has times of its own."""
    camera = view.camera
    return camera.trajectory.time.shape[0] > 1 or isinstance(
        camera.aperture.focus_distance, FocusPull
    )


def _counted_from(view: View, first: float) -> View:
    time = view.time - first
    camera = dataclasses.replace(view.camera, time=to_device(time, view.camera.time.dtype))
    return dataclasses.replace(view, time=time, camera=camera)
