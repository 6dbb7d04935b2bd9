"""Training pictures of several sizes, at one size: those of a fit are stacked."""

import dataclasses
import warnings
from typing import Any

from gaussray.capture.capture import View
from gaussray.capture.errors import CaptureWarning
from gaussray.capture.stored_part import Window
from gaussray.capture.view_part import camera_of_part, part_of_view


# Pictures are cropped to their common part if that keeps this share of every picture; upright and
# lying ones of 4 x 3 would lose a quarter.
_COMMON = 0.85
# Of pictures of quite different sizes, none keeps a side that is more than so many times as long as
# the longest one of the smallest picture: the others would be small islands in theirs.
_LARGER = 2.0


def same_size(views: list[View]) -> list[View]:
    """The views at one size, in one film.

    If their sizes differ a little, as those of COLMAP's undistorted pictures do, they are cropped
    about their middles. Otherwise each is put into the middle of a film that holds all of them, and
    its margin shows nothing (`View.margin`). A warning tells the sizes.
    """
    sizes = {(view.width, view.height) for view in views}
    if len(sizes) < 2:
        return views
    common = min(w for w, _ in sizes), min(h for _, h in sizes)
    listed = ", ".join(f"{w} x {h}" for w, h in sorted(sizes)[:5]) + (", ..." * (len(sizes) > 5))
    made: dict[Any, Any] = {}
    if all(common[0] * common[1] >= _COMMON * w * h for w, h in sizes):
        result = [_cropped(view, common, made) for view in views]
        done = f"all are cropped to {common[0]} x {common[1]}"
    else:
        longest = _LARGER * min(max(size) for size in sizes)
        views = [_no_longer(view, longest, made) for view in views]
        whole = max(view.width for view in views), max(view.height for view in views)
        result = [_framed(view, whole, made) for view in views]
        done = f"each is in the middle of one of {whole[0]} x {whole[1]}, and nothing counts around"
    warnings.warn(
        f"training pictures have {len(sizes)} sizes ({listed}); {done}.",
        CaptureWarning,
        stacklevel=2,
    )
    return result


def _no_longer(view: View, longest: float, made: dict[Any, Any]) -> View:
    """A view no side of which is longer than that."""
    factor = longest / max(view.width, view.height)
    if factor >= 1:
        return view
    size = max(round(factor * view.width), 1), max(round(factor * view.height), 1)
    return part_of_view(view, (0, 0, view.width, view.height), size, made)


def _cropped(view: View, size: tuple[int, int], made: dict[Any, Any]) -> View:
    """The middle of a view; of a resized one, whole pixels of the file, resized nearly as much."""
    if (view.width, view.height) == size:
        return view
    left, top = (view.width - size[0]) // 2, (view.height - size[1]) // 2
    return part_of_view(view, (left, top, *size), size, made)


def _framed(view: View, size: tuple[int, int], made: dict[Any, Any]) -> View:
    """A view in the middle of a larger film."""
    if (view.width, view.height) == size:
        return view
    left, top = (size[0] - view.width) // 2, (size[1] - view.height) // 2
    margin = left, top, size[0] - view.width - left, size[1] - view.height - top
    seen = Window((view.width, view.height), (-left, -top, *size))
    return dataclasses.replace(view, camera=camera_of_part(view, seen, size, made), margin=margin)
