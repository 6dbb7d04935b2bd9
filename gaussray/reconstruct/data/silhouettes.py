"""Masks that cut a thing out of the pictures: where they hide, nothing is to be reconstructed."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import binary_erosion

from gaussray.capture.capture import View
from gaussray.capture.frames import visible_pixels
from gaussray.capture.spread import evenly_spread


# Masks cut something out if they hide at least this share of the rim of what all pictures together
# show: its pixels that are nearer to the outside than so much of the picture's shorter side. Where
# masks hide what a lens leaves dark, or passers-by, most pictures show that rim.
_SHARE, _RIM = 0.5, 0.03
# Pictures whose masks are looked at.
_LOOKED_AT = 32

SILHOUETTES_SENTENCE = (
    "Masks cut an object out of the pictures: what they hide is taken as empty "
    "(loss.outside_opacity=0 leaves it open)."
)


def are_silhouettes(views: Sequence[View]) -> bool:
    """Whether the masks of views cut a thing out. Other masks hide passers-by, or what a lens
    leaves dark: what is behind these is not known. Nor is what a margin hides, so views with
    margins are none.

    Args:
        views: the training views, of one size.
    """
    masked = any(view.mask is not None or view.background == "mask" for view in views)
    if not masked or any(any(view.margin) for view in views):
        return False
    shown = np.stack([visible_pixels(view) for view in evenly_spread(list(views), _LOOKED_AT)])
    rim = _rim(np.asarray(shown.any(axis=0)))
    return bool(rim.any() and np.mean(~shown[:, rim]) >= _SHARE)


def _rim(seen: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The outer pixels of a region."""
    width = max(round(_RIM * min(seen.shape)), 1)
    return seen & ~np.asarray(binary_erosion(seen, iterations=width), bool)
