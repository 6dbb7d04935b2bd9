"""Masks that cut a thing out of the pictures: where they hide, nothing is to be reconstructed."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from gaussray.capture.capture import View
from gaussray.capture.frames import visible_pixels
from gaussray.capture.spread import evenly_spread


# Masks cut something out if at least this share of the pixels at the pictures' borders is hidden,
# and if they differ from picture to picture in more than so many pixels: what a lens leaves dark
# is the same in all.
_SHARE, _SAME = 0.5, 0.001
# Pictures whose masks are looked at.
_LOOKED_AT = 32

SILHOUETTES_SENTENCE = (
    "Masks hide most of the pictures' border, and not the same pixels everywhere: they are taken "
    "as silhouettes, and what they hide as empty (loss.backdrop_opacity=0 leaves it open)."
)


def are_silhouettes(views: Sequence[View]) -> bool:
    """Whether the masks of views cut a thing out. Other masks hide passers-by, or what a lens
    leaves dark: what is behind these is not known.

    Args:
        views: the training views.
    """
    if not any(view.mask is not None or view.background == "mask" for view in views):
        return False
    chosen = evenly_spread(list(views), _LOOKED_AT)
    shown = [visible_pixels(view) for view in chosen]
    known = [_inside(view, mask.shape) for view, mask in zip(chosen, shown, strict=True)]
    border = np.concatenate(
        [mask[_edge(inside)] for mask, inside in zip(shown, known, strict=True)]
    )
    if np.mean(~border) < _SHARE:
        return False
    first = shown[0]
    return any(
        mask.shape != first.shape or np.mean((mask != first)[inside & known[0]]) > _SAME
        for mask, inside in zip(shown[1:], known[1:], strict=True)
    )


def _inside(view: View, shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """The pixels of a view within its margin, of which the picture tells nothing."""
    left, top, right, bottom = view.margin
    inside = np.zeros(shape, bool)
    inside[top : shape[0] - bottom, left : shape[1] - right] = True
    return inside


def _edge(inside: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The outermost pixels of a rectangle."""
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    edge = inside.copy()
    edge[rows[0] + 1 : rows[-1], columns[0] + 1 : columns[-1]] = False
    return edge
