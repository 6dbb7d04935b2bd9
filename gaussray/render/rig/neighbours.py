"""The frames of a rig, and those before and after one that stands alone."""

import dataclasses
from collections import Counter
from collections.abc import Sequence

from gaussray.camera.camera import Camera
from gaussray.capture.capture import View
from gaussray.io.plain_values import to_device
from gaussray.render.rig.trajectory import TrajectoryOptions, move_cameras


# Times that differ by less are equal: absolute, and relative to the time.
_SAME_TIME = 1e-6

# Camera name, split and camera of a frame.
_Frame = tuple[str, str, Camera]
# The cameras before and after a frame; None where there is none.
_Neighbours = tuple[Camera | None, Camera | None]


def moved_frames(
    views: Sequence[View],
    chosen: Sequence[View],
    options: TrajectoryOptions,
    *,
    names: Sequence[str] = (),
    within: tuple[float, float] | None = None,
) -> tuple[list[_Frame], dict[str, _Neighbours]]:
    """The chosen frames with their trajectories, and the neighbours of those that stand alone.

    The neighbours of the only frame of a camera are the capture's own views of that camera, the
    last before and the first after it, with their poses. The only frame of a ride has the ride at
    the times at which the capture has its first chosen camera.

    Args:
        views: all views of the capture.
        chosen: those that are rendered, at least one.
        options: the trajectory.
        names: the cameras that a ride passes, in their order (`move_cameras`).
        within: first and last time of neighbours, those of the scene; None: no frame has any.

    Returns:
        The frames; and the neighbours by camera name.
    """
    named = [_frame(view) for view in chosen]
    if options.kind != "keep":
        frames = move_cameras(named, options, names)
        if within is None or len(frames) > 1:
            return frames, {}
        ((name, _, camera),) = frames
        near = views_beside(views, chosen[0].camera_name, float(camera.time), within)
        before, after = (view and _at(camera, view.time) for view in near)
        return frames, {name: (before, after)}
    beside: dict[str, tuple[View | None, View | None]] = {}
    counts = Counter(view.camera_name for view in chosen)
    for view in chosen if within is not None else ():
        if counts[view.camera_name] == 1:
            beside[view.camera_name] = views_beside(views, view.camera_name, view.time, within)
    # Moved together with the frames, so that a camera and its neighbours share a shake.
    others = [view for pair in beside.values() for view in pair if view is not None]
    moved = move_cameras([*named, *map(_frame, others)], options)
    rest = iter(moved[len(named) :])
    neighbours: dict[str, _Neighbours] = {}
    for name, pair in beside.items():
        before, after = (None if view is None else next(rest)[2] for view in pair)
        neighbours[name] = before, after
    return moved[: len(named)], neighbours


def views_beside(
    views: Sequence[View], name: str, time: float, within: tuple[float, float] | None = None
) -> tuple[View | None, View | None]:
    """The last view of a camera before a time, and the first after it; None where there is none.

    Args:
        views: the views of all cameras.
        name: the camera.
        time: the time.
        within: first and last time of a view that counts; None: all count.
    """
    own = [view for view in views if view.camera_name == name]
    earlier = [view for view in own if _is_before(view.time, time)]
    later = [view for view in own if _is_before(time, view.time)]
    before = max(earlier, key=lambda view: view.time, default=None)
    after = min(later, key=lambda view: view.time, default=None)
    if within is not None and before is not None and _is_before(before.time, within[0]):
        before = None
    if within is not None and after is not None and _is_before(within[1], after.time):
        after = None
    return before, after


def _is_before(first: float, second: float) -> bool:
    """Whether a time is before another one by more than the rounding of single precision."""
    return second - first > _SAME_TIME * max(1.0, abs(first), abs(second))


def _frame(view: View) -> _Frame:
    return view.camera_name, view.split, view.camera


def _at(camera: Camera, time: float) -> Camera:
    """The camera at another time."""
    return dataclasses.replace(camera, time=to_device(time, camera.time.dtype))
