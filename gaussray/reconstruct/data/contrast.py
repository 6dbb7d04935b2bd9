"""How much the pixels of pictures differ, against which costs of the loss are weighed."""

import numpy as np

from gaussray.capture.spread import spread_indices
from gaussray.reconstruct.data.pictures import Footage


# Contrast of the captures on which costs of opacity and scale were chosen: 0.15 to 0.22
# (experiments/captures/log.md).
_USUAL = 0.15
# Pictures that are looked at, and of their pixels at most so many.
_LOOKED_AT, _PIXELS = 32, 500_000


def contrast_of(footage: Footage) -> float:
    """Mean difference of the pixels from their median, in sRGB-encoded values of 0..1: what a
    picture of one colour would have as its L1 error. 0 where no pixel counts.

    Args:
        footage: the training pictures; pixels that are masked do not count.
    """
    chosen = spread_indices(len(footage.times), _LOOKED_AT)
    pixel, visible = footage.pixel[chosen], footage.visible(chosen)
    pixel = pixel.reshape(-1, 3) if visible is None else pixel[visible]
    if not len(pixel):
        return 0.0
    some = pixel[:: -(-len(pixel) // _PIXELS)].astype(np.float32) / footage.scale
    return float(np.abs(some - np.median(some, axis=0)).mean())


def share_of_costs(footage: Footage) -> float:
    """By how much costs of opacity and scale count for pictures: less than 1 where they have little
    contrast, as those of a small thing in the dark.

    The costs are weighed against the error of pixels, which contrast bounds. Where it is small,
    costs that suit daylight make everything transparent.

    Args:
        footage: the training pictures.
    """
    # Rounded, as steps are compiled for each value anew.
    return min(1.0, round(contrast_of(footage) / _USUAL, 2))
