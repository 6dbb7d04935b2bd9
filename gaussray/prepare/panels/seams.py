"""Seams of a picture: straight lines over its whole height or width at which its content ends."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import maximum_filter1d

from gaussray.prepare.panels.layout import PanelLayout


# Rows that are looked at.
_ROWS = 256
# A step is a difference of the levels on both sides of a line: of pixels that are three apart,
# because compression and scaling soften it, and of nine apart, because a thin line is none.
_NEAR, _FAR = 3, 9
# It counts if it is of so many levels, and so many times as high as those beside it.
_LEAST, _LONE = 8, 2
# Pixels beside a step, on each side, that belong to it; and those whose steps it is compared with.
_OWN, _BESIDE = 3, 6
# Places so near to a cut or to the border are not looked at for other seams.
_MARGIN = 14


class Seams(NamedTuple):
    """The seams of a layout in a picture.

    Args:
        cuts: for each cut of its rows and then of its columns, the share of the line with a step.
        other: the largest such share along another line of the same direction.
    """

    cuts: tuple[float, ...]
    other: float


def find_seams(picture: UInt8[np.ndarray, "h w 3"], layout: PanelLayout) -> Seams:
    """How much of each cut of a layout is a seam: a few hundredths in most pictures of one view.

    Of a grid each cut is looked at in each row or column of panels, and the least share counts.

    Args:
        picture: levels.
        layout: arrangement of panels.
    """
    cuts, other = [], 0.0
    for count, across, upright in (
        (layout.rows, layout.columns, picture.swapaxes(0, 1)),
        (layout.columns, layout.rows, picture),
    ):
        if count == 1:
            continue
        shares = [_step_shares(band) for band in np.array_split(upright, across)]
        size = upright.shape[1]
        places = [round(size * k / count) for k in range(1, count)]
        cuts += [min(float(own[at - 1 : at + 2].max()) for own in shares) for at in places]
        for own in shares:
            for at in (0, *places, size):
                own[max(at - _MARGIN, 0) : at + _MARGIN + 1] = 0
            other = max(other, float(own.max()))
    return Seams(tuple(cuts), other)


def _step_shares(picture: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, " places"]:
    """The share of the rows with a lone step before each column, and after the last one."""
    height, width = picture.shape[:2]
    shares = np.zeros(width + 1)
    if width < 4 * _MARGIN or not height:
        return shares
    rows = picture[:: max(height // _ROWS, 1)].astype(np.int16)
    step, far = (np.abs(rows[:, d:] - rows[:, :-d]).mean(axis=2) for d in (_NEAR, _FAR))
    # Of each place the highest step within the next six places, which the next line shifts.
    most = maximum_filter1d(step, _BESIDE, axis=1, origin=-(_BESIDE // 2))
    beside = np.zeros_like(step)
    beside[:, _OWN + _BESIDE :] = most[:, : -(_OWN + _BESIDE)]
    later = _OWN + 1
    beside[:, :-later] = np.maximum(beside[:, :-later], most[:, later:])
    high = step > np.maximum(_LEAST, _LONE * beside)
    # Both differences are about the same line.
    shift = (_FAR - _NEAR) // 2
    high[:, :shift] = high[:, -shift:] = False
    high[:, shift:-shift] &= far > _LEAST
    # The difference k is of the columns k and k + 3, so that its line is before column k + 2.
    shares[2 : 2 + high.shape[1]] = high.mean(axis=0)
    return shares
