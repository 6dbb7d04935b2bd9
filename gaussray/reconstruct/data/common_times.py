"""Cameras that nothing synchronises: their pictures at common times, each with its own delay."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from gaussray.camera.shutter import Shutter
from gaussray.capture.capture import Capture, View, viewpoints
from gaussray.io.plain_values import to_device
from gaussray.reconstruct.data.still_cameras import FEWEST_FRAMES, one_at_a_time


# Cameras whose times are tried as the common ones, at most.
_TRIED = 50
# Shares of the time between two pictures of a camera. Up to the first from a common time, pictures
# are put to it in any case. Where one is further from all than the second, clocks have gaps, and
# all pictures keep their own times.
_NEAR, _FAR = 0.1, 0.6


def with_common_times(capture: Capture) -> Capture:
    """The capture, with training pictures of cameras that stand still at common times.

    Stereo looks at the pictures of one time. Cameras that nothing synchronises have none of the
    same. So each picture is put to the nearest time of one of these cameras, and what is left of
    its own time becomes the delay of its shutter (`Shutter.trigger`): rays keep the times at which
    they were recorded.

    It is done where most times have a single picture, or where no picture moves by more than a
    tenth of the time between two pictures of a camera. Otherwise, where clocks have gaps, and where
    the pictures already have common times, the capture stays as it is.

    Args:
        capture: the capture.
    """
    places = [k for k, view in enumerate(capture.views) if view.split == "train"]
    views = [capture.views[k] for k in places]
    if len(views) < 2 * FEWEST_FRAMES:
        return capture
    times = np.array([view.time for view in views])
    found = common_times(times, np.array(viewpoints(views)))
    if found is None:
        return capture
    changed = list(capture.views)
    for k, view, time in zip(places, views, found.tolist(), strict=True):
        changed[k] = _at(view, time)
    return replace(capture, views=changed)


def common_times_sentence(recorded: Capture, capture: Capture) -> str:
    """A line that tells of common times; empty if the capture is as recorded.

    Args:
        recorded: the capture as recorded.
        capture: the capture after `with_common_times`.
    """
    if capture is recorded:
        return ""
    pairs = zip(recorded.views, capture.views, strict=True)
    late = max(abs(before.time - after.time) for before, after in pairs)
    times = [view.time for view in capture.views if view.split == "train"]
    return (
        f"The cameras are not synchronised: {len(times)} pictures are looked at together at "
        f"{len(set(times))} times, up to {late:.3g} from their own, which their rays keep."
    )


def common_times(
    times: Float[np.ndarray, " pictures"], viewpoint: Int[np.ndarray, " pictures"]
) -> Float[np.ndarray, " pictures"] | None:
    """The common time of each picture; None where they are to keep their own.

    Args:
        times: the time of each picture.
        viewpoint: the number of the fixed viewpoint of each.
    """
    own = [np.flatnonzero(viewpoint == number) for number in np.unique(viewpoint)]
    still = [which for which in own if len(np.unique(times[which])) >= FEWEST_FRAMES]
    if len(still) < 2 or 2 * sum(map(len, still)) <= len(times):
        return None
    gaps = [float(np.median(np.diff(np.sort(times[which])))) for which in still]
    gap = min(gaps)
    fastest = [w for w, g in zip(still, gaps, strict=True) if g < (1 + _NEAR) * gap][:_TRIED]
    every = np.concatenate(still)
    grids = [_continued(np.unique(times[which]), gap, times[every]) for which in fastest]
    nearest = [g[np.searchsorted((g[1:] + g[:-1]) / 2, times[every])] for g in grids]
    best = nearest[int(np.argmin([np.sum((times[every] - near) ** 2) for near in nearest]))]
    found = times.copy()
    found[every] = best
    shift = np.abs(found - times).max()
    fewer = len(np.unique(found)) < len(np.unique(times))
    alike = shift <= _NEAR * gap or one_at_a_time(times)
    # Two pictures of one camera are two times.
    several = any(len(np.unique(found[w])) < len(np.unique(times[w])) for w in still)
    return found if fewer and alike and not several and shift <= _FAR * gap else None


def _continued(
    grid: Float[np.ndarray, " times"], gap: float, times: Float[np.ndarray, " pictures"]
) -> Float[np.ndarray, " more"]:
    """The times of a camera, continued to both sides as far as others have pictures."""
    before = int(np.round(max(grid[0] - np.min(times), 0) / gap))
    after = int(np.round(max(np.max(times) - grid[-1], 0) / gap))
    first = grid[0] - gap * np.arange(before, 0, -1)
    return np.concatenate([first, grid, grid[-1] + gap * np.arange(1, after + 1)])


def _at(view: View, time: float) -> View:
    """A view at another time, which its shutter's delay makes up for."""
    camera, dtype = view.camera, view.camera.time.dtype
    shutter: Shutter = camera.shutter
    before = 0.0 if shutter.trigger is None else float(shutter.trigger)
    delay = to_device(before + view.time - time, dtype)
    shutter = replace(shutter, trigger=delay)
    return replace(
        view, time=time, camera=replace(camera, shutter=shutter, time=to_device(time, dtype))
    )
