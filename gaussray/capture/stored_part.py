"""The part of a stored picture that a view shows, and its averages over larger pixels."""

import functools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float


if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Window(NamedTuple):
    """A `box` (left, top, width, height) in the pixels of a stored picture of `size` (width,
    height)."""

    size: tuple[int, int]
    box: tuple[float, float, float, float]

    def cut(self, picture: np.ndarray) -> np.ndarray:
        """What of a stored picture [h, w, ...] is in the box."""
        left, top, width, height = (int(x) for x in self.box)
        return picture[top : top + height, left : left + width]


def averaged(
    picture: Float[np.ndarray, "rows columns c"], width: int, height: int
) -> Float[np.ndarray, "h w c"]:
    """The means of a picture over the areas of larger pixels, all of one size.

    Source pixels that lie in two areas count in each by their share, so that every edge and the
    mean of the picture stay exactly where they were. Equal sizes give the picture back.

    Args:
        picture: the picture, in linear light if its means are to be those of a sensor.
        width: columns of the result.
        height: rows of the result.
    """
    rows, columns, channels = picture.shape
    lower = _shares(rows, height).astype(picture.dtype) @ picture.reshape(rows, -1)
    lower = lower.reshape(height, columns, channels).swapaxes(0, 1).reshape(columns, -1)
    both = _shares(columns, width).astype(picture.dtype) @ lower
    return np.ascontiguousarray(both.reshape(width, height, channels).swapaxes(0, 1))


@functools.lru_cache(maxsize=16)
def _shares(fine: int, coarse: int) -> "csr_array":
    """Share of each of `fine` source pixels in the mean over each of `coarse` areas."""
    # Whole numbers: in units of 1/coarse of a source pixel an area is `fine` long. Between two
    # edges there is one pixel and one area.
    edges = np.union1d(np.arange(fine + 1) * coarse, np.arange(coarse + 1) * fine)
    start, share = edges[:-1], np.diff(edges) / fine
    # Imported here: that takes a tenth of a second, which whole pictures do not need.
    from scipy.sparse import csr_array

    return csr_array((share, (start // fine, start // coarse)), shape=(coarse, fine))
