"""Cameras of pictures that were stored smaller, or larger, than their manifest says."""

import dataclasses
import warnings
from typing import Any

from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.picture_file import picture_size
from gaussray.capture.stored_part import Window
from gaussray.capture.view_part import camera_of_part


def at_stored_sizes(capture: Capture) -> Capture:
    """The capture with cameras of the size of their pictures, where these were resized as a whole.

    The first picture of each folder and size that exists is looked at. If both its sides differ
    from the camera's by one factor, up to a pixel, so do lens and shutter of all cameras of this
    folder and size, and a warning tells. Any other difference is left for the error of the
    picture's reader.
    """
    sizes: dict[tuple[Any, ...], tuple[int, int]] = {}
    for view in capture.all_views:
        if _group(view) in sizes:
            continue
        said, stored = (view.width, view.height), _stored(view)
        if stored:
            sizes[_group(view)] = stored
        if stored and stored != said:
            warnings.warn(
                f"{view.image.parent}: the pictures are {stored[0]} x {stored[1]} where the "
                f"cameras say {said[0]} x {said[1]}; lenses and shutters are scaled with them.",
                CaptureWarning,
                stacklevel=3,
            )
    made: dict[Any, Any] = {}

    def fitting(view: View) -> View:
        said = view.width, view.height
        stored = sizes.get(_group(view), said)
        return view if stored == said else _resized(view, stored, made)

    return capture.with_views(lambda views: [fitting(view) for view in views])


def _group(view: View) -> tuple[Any, ...]:
    """Pictures that were resized alike: those of one folder and of cameras of one size."""
    return view.image.parent, view.width, view.height


def _stored(view: View) -> tuple[int, int] | None:
    """Width and height of a picture that was resized as a whole, or the camera's if it was not;
    None if the picture cannot be read."""
    try:
        width, height = picture_size(view.image)
    except (OSError, CaptureError):
        return None
    said = view.width, view.height
    apart = abs(width * view.height - height * view.width)
    return (width, height) if apart <= max(said) else said


def _resized(view: View, size: tuple[int, int], made: dict[Any, Any]) -> View:
    """The view with a camera of another size."""
    whole = view.width, view.height
    seen = Window(whole, (0, 0, *whole))
    return dataclasses.replace(view, camera=camera_of_part(view, seen, size, made))
