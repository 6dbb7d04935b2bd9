"""What of a capture is used: instants, a part of the pictures, their size, cameras held out."""

import dataclasses
from collections.abc import Callable
from fnmatch import fnmatchcase
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gaussray.camera.shutter import Shutter
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.paired import Capture, View
from gaussray.capture.window import Window


class Selection(eqx.Module):
    """What of a capture is used; the defaults are all of it.

    `frames` is the first and the last index and the step of the capture's instants (-1 is the last
    one). `crop` is left, top, width and height in the pixels of the files. `scale` shrinks what is
    left of a picture, in (0, 1]. `test` names the cameras that are held out, by name or pattern
    (`cam0*`), and all others train; "auto" leaves that to the format.
    """

    frames: tuple = eqx.field(static=True, default=())
    crop: tuple = eqx.field(static=True, default=())
    scale: float = eqx.field(static=True, default=1.0)
    test: tuple = eqx.field(static=True, default=("auto",))

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


def selected(capture: Capture, selection: Selection) -> Capture:
    """The capture that is left: its views are fewer, smaller, or held out by other names.

    Lens and shutter follow the pixels exactly: a point of the scene stays at the same place of the
    picture, and each row has the time of its middle. The sides become round(scale * side), and the
    lens is scaled by what that makes of each. Pixel filters keep their width in pixels, for
    averages over pixels are a filter themselves. Times stay as they are; views of effects are kept
    at the instants of the pinhole views that are. `test` concerns pinhole views alone.

    CaptureError for instants, boxes or cameras that the capture does not have.
    """
    keep = _instants(capture, selection)
    made: dict[Any, Any] = {}

    def chosen(views: list[View]) -> list[View]:
        return [_through(view, selection, made) for view in views if keep(view)]

    views = _held_out(chosen(capture.views), selection)
    effects = {name: chosen(some) for name, some in capture.effects.items()}
    effects = {name: some for name, some in effects.items() if some}
    times = [view.time for view in views or [view for some in effects.values() for view in some]]
    return dataclasses.replace(
        capture, views=views, effects=effects, time_range=(min(times), max(times))
    )


def _instants(capture: Capture, selection: Selection) -> Callable[[View], bool]:
    if not selection.frames:
        return lambda view: True
    listed = capture.views or [view for some in capture.effects.values() for view in some]
    times = sorted({view.time for view in listed})
    first, last, step = selection.frames
    ends = [place + len(times) if place < 0 else place for place in (first, last)]
    if not 0 <= ends[0] <= ends[1] < len(times):
        rule = f"first, last and step of {len(times)} instants (0 ... {len(times) - 1})"
        raise _error("frames", f"{rule}, first not after last", selection.frames)
    kept = set(times[ends[0] : ends[1] + 1 : step])
    return lambda view: view.time in kept


def _held_out(views: list[View], selection: Selection) -> list[View]:
    if selection.test == ("auto",):
        return views
    names = list(dict.fromkeys(view.camera_name for view in views))
    for pattern in selection.test:
        if not any(fnmatchcase(name, pattern) for name in names):
            listed = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
            raise _error("test", f"a list of the capture's cameras ({listed})", selection.test)
    held = {n for n in names if any(fnmatchcase(n, pattern) for pattern in selection.test)}
    return [
        dataclasses.replace(view, split="test" if view.camera_name in held else "train")
        for view in views
    ]


def _through(view: View, selection: Selection, made: dict[Any, Any]) -> View:
    """The view of the part and size that were chosen."""
    whole = (0, 0, view.width, view.height)
    box = selection.crop or whole
    left, top, width, height = box
    if left + width > view.width or top + height > view.height:
        rule = f"within the picture of {view.width} x {view.height} at {view.image}"
        raise _error("crop", rule, selection.crop)
    size = tuple(max(round(selection.scale * side), 1) for side in (width, height))
    if box == whole and size == (view.width, view.height):
        return view
    window = Window((view.width, view.height), (left, top, width, height))
    camera = view.camera
    # Views share most of their lenses and shutters.
    key = id(camera.lens), id(camera.shutter), window
    if key not in made:
        lens, shutter = camera.lens, camera.shutter
        resized = lens.resized(*window, (size[0], size[1]))
        made[key] = resized, _shutter_through(shutter, window, size)
    lens, shutter = made[key]
    film = dataclasses.replace(camera.film, width=size[0], height=size[1])
    camera = dataclasses.replace(camera, film=film, lens=lens, shutter=shutter)
    return dataclasses.replace(view, camera=camera, window=window)


def _shutter_through(shutter: Shutter, window: Window, size: tuple[int, ...]) -> Shutter:
    """Row i' of the smaller picture lies around row lead + (i' + 1/2) / scale - 1/2."""
    left, top, width, height = window.box
    lead, rows, new = {
        "top_to_bottom": (top, height, size[1]),
        "bottom_to_top": (window.size[1] - top - height, height, size[1]),
        "left_to_right": (left, width, size[0]),
        "right_to_left": (window.size[0] - left - width, width, size[0]),
    }[shutter.direction]
    step = rows / new
    table = shutter.row_times
    if table is not None:
        # Means over the rows that a row of the smaller picture is made of, in part or in whole.
        total = np.concatenate([[0], np.cumsum(np.asarray(table, np.float64))])
        edges = np.interp(lead + step * np.arange(new + 1), np.arange(len(total)), total)
        table = jnp.asarray(np.diff(edges) / step, table.dtype)
    return dataclasses.replace(
        shutter,
        row_offset=shutter.row_offset + shutter.row_step * (lead + step / 2 - 0.5),
        row_step=shutter.row_step * step,
        row_times=table,
    )


def _whole(values: tuple, count: int) -> bool:
    return len(values) in (0, count) and all(type(value) is int for value in values)


def _error(key: str, rule: str, value: Any) -> CaptureError:
    value = list(value) if isinstance(value, tuple) else value
    return CaptureError(f"capture.{key} (truth_{key}) must be {rule}, got {value}.")
