"""How much the pixels of pictures differ, against which the cost of opacity is weighed."""

import numpy as np

from gaussray.capture.spread import spread_indices
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.optimize.density import DensityOptions


# From this contrast on opacity costs what it does in daylight: the contrast of the demo. Four other
# captures in daylight have 0.10 to 0.22 (experiments/captures/log.md).
_USUAL = 0.15
# Pictures that are looked at, and tiles of each, at most.
_LOOKED_AT, _TILES = 32, 64


def contrast_of(footage: Footage) -> float:
    """Mean difference of the pixels from their median, in sRGB-encoded values of 0..1: what a
    picture of one colour would have as its L1 error. 0 where no pixel counts.

    Args:
        footage: the training pictures; pixels that are masked do not count.
    """
    # A part alone, as the pictures may lie in a file.
    frames = spread_indices(len(footage.times), _LOOKED_AT)[:, None]
    tiles = spread_indices(footage.pixel.shape[1], _TILES)
    pixel, visible = footage.pixel[frames, tiles], footage.visible(frames, tiles)
    pixel = pixel.reshape(-1, 3) if visible is None else pixel[visible]
    if not len(pixel):
        return 0.0
    some = pixel.astype(np.float32) / footage.scale
    # Lamps of an HDR picture, far brighter than white, are white here; what is no number is black.
    some = np.clip(np.nan_to_num(some, posinf=1.0), 0, 1)
    return float(np.abs(some - np.median(some, axis=0)).mean())


def cost_at_contrast(cost: float, contrast: float) -> float:
    """What the mean opacity of all Gaussians costs for pictures of some contrast.

    The cost is weighed against the error of pixels, which contrast bounds. Where it is small (a
    small thing in the dark), a cost that suits daylight makes everything transparent. So it falls
    in proportion to contrast, but to no less than the default, which suited the dark as well.

    Args:
        cost: what it costs at usual contrast, `density.opacity_cost`.
        contrast: `contrast_of` the training pictures.
    """
    # Rounded, as steps are compiled for each value anew.
    share = round(min(contrast / _USUAL, 1.0), 1)
    return max(share * cost, min(cost, DensityOptions().opacity_cost))
