"""The part of a capture that is used: times, crop, size, held-out cameras, missing pictures."""

import dataclasses
import warnings
from collections.abc import Callable
from fnmatch import fnmatchcase
from typing import Any

import equinox as eqx
import numpy as np

from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.picture_places import absent_picture_hint
from gaussray.capture.picture_file import picture_exists
from gaussray.capture.view_part import part_of_view


# What is done with frames whose picture does not exist.
MISSING = ("skip", "error")


class Selection(eqx.Module):
    """The part of a capture that is used; the defaults are all of it.

    Args:
        frames: first index, last index (-1 is the last one) and step among the capture's times.
        crop: left, top, width and height in the pixels of the files.
        scale: factor of the sides of the cropped pictures, in (0, 1].
        test: held-out cameras, by name or pattern (`cam0*`); all others are for training. `auto`
            leaves the choice to the format.
        missing: frames whose picture does not exist are left out (`skip`, with a warning that
            counts them) or refused (`error`).
        clip_start: nothing nearer to a camera is seen (`Camera.clip_start`), in scene units; None
            is what the files say, and where they do not, `clip_start.with_clip_starts`.
    """

    frames: tuple = eqx.field(static=True, default=())
    crop: tuple = eqx.field(static=True, default=())
    scale: float = eqx.field(static=True, default=1.0)
    test: tuple[str, ...] = eqx.field(static=True, default=("auto",))
    missing: str = eqx.field(static=True, default="skip")
    clip_start: float | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        rule = "[] (all) or three whole numbers: first, last, step (at least 1)"
        if not _whole(self.frames, 3) or self.frames and self.frames[2] < 1:
            raise _error("frames", rule, self.frames)
        rule = "[] (all) or four whole numbers: left, top (at least 0), width, height (at least 1)"
        if not _whole(self.crop, 4) or self.crop and (min(self.crop) < 0 or min(self.crop[2:]) < 1):
            raise _error("crop", rule, self.crop)
        if not 0 < self.scale <= 1:
            raise _error("scale", "in (0, 1]", self.scale)
        if not all(isinstance(name, str) and name for name in self.test):
            raise _error("test", "a list of cameras' names", self.test)
        if self.missing not in MISSING:
            raise _error("missing", f"one of {', '.join(MISSING)}", repr(self.missing))
        if self.clip_start is not None and not 0 <= self.clip_start < np.inf:
            raise _error("clip_start", "null or a number of at least 0", self.clip_start)


def selected(capture: Capture, selection: Selection) -> Capture:
    """The selected part of a capture: its views are fewer, smaller, or have other splits.

    Lens and shutter follow the pixels exactly: a point of the scene stays at the same place of the
    picture, and each row has the time of its middle. The sides become round(scale * side), and the
    lens is scaled by the resulting factor of each side. Pixel filters keep their width in pixels,
    because an average over pixels is a filter too. Times stay as they are; views of effects are
    kept at the times of the kept pinhole views. `test` concerns pinhole views only.

    Args:
        capture: the whole capture.
        selection: times, crop, scale and held-out cameras, and what to do about missing pictures.

    Raises:
        CaptureError: the capture does not have the times, box or cameras, or lacks pictures.
    """
    capture = _with_pictures(capture, selection.missing)
    keep = _is_at_kept_time(capture, selection)
    made: dict[Any, Any] = {}

    def chosen(views: list[View]) -> list[View]:
        return [cropped_and_scaled(view, selection, made) for view in views if keep(view)]

    capture = capture.with_views(chosen)
    views = _held_out(capture.views, selection)
    times = [view.time for view in views or capture.all_views]
    return dataclasses.replace(capture, views=views, time_range=(min(times), max(times)))


def _with_pictures(capture: Capture, missing: str) -> Capture:
    """The capture without the views whose pictures do not exist."""
    every = capture.all_views
    absent = {id(view) for view in every if not picture_exists(view.image)}
    if not absent:
        return capture
    lacking = [view.image for view in every if id(view) in absent]
    first = lacking[0]
    text = (
        f"{capture.folder}: {len(absent)} of {len(every)} frames have no picture, such as {first}"
    )
    if missing == "error" or len(absent) == len(every):
        remedy = "Copy the pictures of these frames there, or remove the frames."
        hint = absent_picture_hint(capture.folder, (path.name for path in lacking), remedy)
        raise CaptureError(f"{text}.{hint}")
    warnings.warn(f"{text}; they are left out.", CaptureWarning, stacklevel=4)

    return capture.with_views(lambda views: [view for view in views if id(view) not in absent])


def _is_at_kept_time(capture: Capture, selection: Selection) -> Callable[[View], bool]:
    """Whether a view has one of the times that `Selection.frames` keeps."""
    if not selection.frames:
        return lambda view: True
    times = sorted({view.time for view in capture.views or capture.all_views})
    first, last, step = selection.frames
    ends = [place + len(times) if place < 0 else place for place in (first, last)]
    if not 0 <= ends[0] <= ends[1] < len(times):
        rule = f"first, last and step of {len(times)} instants (0 ... {len(times) - 1})"
        raise _error("frames", f"{rule}, first not after last", selection.frames)
    kept = set(times[ends[0] : ends[1] + 1 : step])
    return lambda view: view.time in kept


def _held_out(views: list[View], selection: Selection) -> list[View]:
    """The views, split into training and held-out cameras as `Selection.test` says."""
    if selection.test == ("auto",):
        return views
    names = list(dict.fromkeys(view.camera_name for view in views))
    for pattern in selection.test:
        if not any(fnmatchcase(name, pattern) for name in names):
            listed = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
            rule = f"a list of the capture's cameras ({listed})"
            whole = f" A pattern must match the whole name, such as '*{pattern}*'."
            whole = "" if "*" in pattern else whole
            raise _error("test", rule, selection.test, whole)
    held = {n for n in names if any(fnmatchcase(n, pattern) for pattern in selection.test)}
    return [
        dataclasses.replace(view, split="test" if view.camera_name in held else "train")
        for view in views
    ]


def cropped_and_scaled(view: View, selection: Selection, made: dict[Any, Any]) -> View:
    """The part of a view that `Selection.crop` says, at the size that `Selection.scale` says.

    Args:
        view: the whole view.
        selection: crop and scale.
        made: lenses and shutters that are made already; it gets those that are new.
    """
    whole = (0, 0, view.width, view.height)
    box = selection.crop or whole
    left, top, width, height = box
    if left + width > view.width or top + height > view.height:
        rule = f"within the picture of {view.width} x {view.height} at {view.image}"
        raise _error("crop", rule, selection.crop)
    size = max(round(selection.scale * width), 1), max(round(selection.scale * height), 1)
    if box == whole and size == (view.width, view.height):
        return view
    return part_of_view(view, box, size, made)


def _whole(values: tuple, count: int) -> bool:
    return len(values) in (0, count) and all(type(value) is int for value in values)


def _error(key: str, rule: str, value: Any, remedy: str = "") -> CaptureError:
    value = list(value) if isinstance(value, tuple) else value
    return CaptureError(f"capture.{key} (truth_{key}) must be {rule}, got {value}.{remedy}")
