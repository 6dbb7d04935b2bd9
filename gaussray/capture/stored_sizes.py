"""Cameras of pictures that were stored smaller, or larger, than their manifest says."""

import dataclasses
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.picture_file import picture_size
from gaussray.capture.stored_part import Window
from gaussray.capture.videos import frame_of
from gaussray.capture.view_part import camera_of_part


# Headers that are read at once: a file system of the network takes its time for each.
_AT_ONCE = 8

_Size = tuple[int, int]


def at_stored_sizes(capture: Capture) -> Capture:
    """The capture with cameras of the size of their pictures, where these were resized as a whole.

    The header of each picture that exists is read. If both its sides differ from the camera's by
    one factor, up to a pixel, so do lens and shutter of this view. A picture that is absent or
    cannot be read has the size of the others of its folder whose cameras say the same, where these
    have one size. A warning tells the sizes of each folder, and how many pictures there have
    another aspect ratio: these are left for the error of the picture's reader.
    """
    views = capture.all_views
    stored = _stored_sizes(views)
    groups: dict[tuple[Path, _Size], list[View]] = {}
    for view in views:
        if _file(view) in stored:
            groups.setdefault((view.image.parent, _said(view)), []).append(view)
    common: dict[tuple[Path, _Size], _Size] = {}
    for (folder, said), group in groups.items():
        sizes = [stored[_file(view)] for view in group]
        if len(set(sizes)) == 1:
            common[folder, said] = sizes[0]
        text = _sizes_sentence(said, group, sizes)
        if text:
            warnings.warn(f"{folder}: {text}", CaptureWarning, stacklevel=3)
    made: dict[Any, Any] = {}

    def fitting(view: View) -> View:
        said = _said(view)
        size = stored.get(_file(view)) or common.get((view.image.parent, said), said)
        return view if size == said or not _same_aspect(size, said) else _resized(view, size, made)

    return capture.with_views(lambda views: [fitting(view) for view in views])


def _stored_sizes(views: Sequence[View]) -> dict[Path, _Size]:
    """The sizes of the files that can be read: of pictures, and of videos by a frame of each."""
    files = {_file(view): view.image for view in reversed(views)}
    pictures = [image for file, image in files.items() if file == image]
    with ThreadPoolExecutor(_AT_ONCE, "sizes") as threads:
        sizes = dict(zip(pictures, threads.map(_size_or_none, pictures), strict=True))
    sizes |= {file: _size_or_none(image) for file, image in files.items() if file != image}
    return {file: size for file, size in sizes.items() if size is not None}


def _size_or_none(image: Path) -> _Size | None:
    try:
        return picture_size(image)
    except (OSError, CaptureError):
        return None


def _file(view: View) -> Path:
    """The file of a picture, or the video of a frame."""
    frame = frame_of(view.image)
    return view.image if frame is None else frame[0]


def _said(view: View) -> _Size:
    return view.width, view.height


def _same_aspect(size: _Size, said: _Size) -> bool:
    """Whether the sides of two sizes differ by one factor, up to a pixel."""
    return abs(size[0] * said[1] - size[1] * said[0]) <= max(said)


def _sizes_sentence(said: _Size, views: Sequence[View], sizes: Sequence[_Size]) -> str:
    """What a warning says of the pictures of a folder whose cameras say one size; empty if none of
    them is resized.

    Args:
        said: width and height that the cameras say.
        views: these views.
        sizes: width and height of their files.
    """
    resized = sorted({size for size in sizes if size != said and _same_aspect(size, said)})
    if not resized:
        return ""
    first, last = (f"{width} x {height}" for width, height in (resized[0], resized[-1]))
    where = f"where the cameras say {said[0]} x {said[1]}"
    if len(set(sizes)) == 1:
        return f"the pictures are {first} {where}; lenses and shutters are scaled with them."
    count = sum(size in resized for size in sizes)
    shown = first if first == last else f"of {len(resized)} sizes from {first} to {last}"
    text = (
        f"{count} of {len(sizes)} pictures are {shown} {where}; lens and shutter of each are "
        "scaled with its picture."
    )
    # What is stored lying may have an orientation that turns it.
    odd = [k for k, s in enumerate(sizes) if not _same_aspect(s, said) and s[::-1] != said]
    if not odd:
        return text
    name, (width, height) = views[odd[0]].image.name, sizes[odd[0]]
    return (
        f"{text} {len(odd)} {'others have' if len(odd) > 1 else 'other has'} another aspect ratio, "
        f"such as {name} with {width} x {height}, and cannot be read. Resize or remove such files."
    )


def _resized(view: View, size: _Size, made: dict[Any, Any]) -> View:
    """The view with a camera of another size."""
    whole = _said(view)
    seen = Window(whole, (0, 0, *whole))
    return dataclasses.replace(view, camera=camera_of_part(view, seen, size, made))
