"""The part of a picture that a view shows, at another size, and the camera of that part."""

import dataclasses
import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import Shutter
from gaussray.capture.capture import View
from gaussray.capture.stored_part import Window


def part_of_view(
    view: View, box: tuple[int, int, int, int], size: tuple[int, int], made: dict[Any, Any]
) -> View:
    """A view of a part of another view. Of a resized one it shows whole pixels of the file.

    Args:
        view: the view, without a margin.
        box: the part (left, top, width, height), in its pixels.
        size: width and height to which the part is resized.
        made: lenses and shutters that were made already, and that views share (`camera_of_part`).
    """
    stored, seen = _boxes(view, box)
    return dataclasses.replace(view, camera=camera_of_part(view, seen, size, made), window=stored)


def _boxes(view: View, box: tuple[int, int, int, int]) -> tuple[Window, Window]:
    """Where a box of a view lies in its file, and in the view: of a resized view, whole pixels of
    the file that come closest to the box."""
    film = view.width, view.height
    if view.window is None:
        return Window(film, box), Window(film, box)
    corner, sides = np.array(view.window.box[:2]), np.array(view.window.box[2:])
    # Pixels of the file for a pixel of the view.
    fine = sides / film
    lead = np.round(box[:2] * fine)
    part = np.minimum(np.maximum(np.round(box[2:] * fine), 1), sides - lead)
    stored = (*(corner + lead).tolist(), *part.tolist())
    seen = (*(lead / fine).tolist(), *(part / fine).tolist())
    return Window(view.window.size, stored), Window(film, seen)


def camera_of_part(view: View, seen: Window, size: tuple[int, int], made: dict[Any, Any]) -> Camera:
    """The camera of a part of a view.

    Args:
        view: the view.
        seen: the size of its film and the part of it, which may go beyond its edges.
        size: width and height to which the part is resized.
        made: lenses and shutters that were made already: views share most of theirs. It is filled.
    """
    camera = view.camera
    key = id(camera.lens), id(camera.shutter), seen, size
    if key not in made:
        lens, shutter = camera.lens, camera.shutter
        resized = lens.resized(*seen, (size[0], size[1]))
        made[key] = resized, shutter_of_part(shutter, seen, size)
    lens, shutter = made[key]
    film = dataclasses.replace(camera.film, width=size[0], height=size[1])
    return dataclasses.replace(camera, film=film, lens=lens, shutter=shutter)


def shutter_of_part(shutter: Shutter, window: Window, size: tuple[int, ...]) -> Shutter:
    """The shutter of a part of the picture that is resized.

    Row i' of the resized part is centred on row l + (i' + 1/2) s - 1/2 of the picture: l rows are
    read before the part, and s rows become one. A shutter that reads sideways counts columns.

    Args:
        shutter: the shutter of the whole picture.
        window: size of the whole picture, and the part (left, top, width, height), in its pixels;
            rows beyond its edges are read as those at the edges are.
        size: width and height in pixels to which the part is resized.
    """
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
        beyond = math.ceil(max(-lead, lead + rows - len(table), 0))
        wider = np.pad(np.asarray(table, np.float64), beyond, mode="edge")
        total = np.concatenate([[0], np.cumsum(wider)])
        place = beyond + lead + step * np.arange(new + 1)
        edges = np.interp(place, np.arange(len(total)), total)
        table = jnp.asarray(np.diff(edges) / step, table.dtype)
    return dataclasses.replace(
        shutter,
        row_offset=shutter.row_offset + shutter.row_step * (lead + step / 2 - 0.5),
        row_step=shutter.row_step * step,
        row_times=table,
    )
