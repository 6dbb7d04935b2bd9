"""Pictures at low resolution, compared: whether two show the same."""

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter


# Rows and columns to which a picture is reduced. Its details are what is left without a blur of so
# many reduced pixels: brightness that falls off from the middle, or a white background, is none.
_ROWS, _COLUMNS, _BLUR = 48, 64, 4.0
# Correlation of the details of two pictures that show the same: 0.99 and more for a video and its
# copy of half the size, above 0.7 for most pictures of a standing camera. Those of two views with a
# logo over both reach 0.3 to 0.4.
_ALIKE = 0.5


def low_details(picture: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "rows columns"]:
    """The details of a picture at low resolution; zeros of one that is smaller than that."""
    height, width = picture.shape[:2]
    if height < _ROWS or width < _COLUMNS:
        return np.zeros((_ROWS, _COLUMNS))
    levels = picture[..., 1].astype(np.float64)
    for axis, (size, count) in enumerate(((height, _ROWS), (width, _COLUMNS))):
        starts = size * np.arange(count + 1) // count
        sums = np.add.reduceat(levels, starts[:-1], axis=axis)
        levels = sums / np.expand_dims(np.diff(starts), 1 - axis)
    return levels - gaussian_filter(levels, _BLUR)


def details_differ(
    first: Float[np.ndarray, "rows columns"], second: Float[np.ndarray, "rows columns"]
) -> bool:
    """Whether two pictures show different things; not if one is plain, which tells nothing.

    Args:
        first: details of one picture (`low_details`).
        second: details of the other.
    """
    spread = first.std() * second.std()
    if min(first.std(), second.std()) < 1:
        return False
    return float(((first - first.mean()) * (second - second.mean())).mean() / spread) < _ALIKE
