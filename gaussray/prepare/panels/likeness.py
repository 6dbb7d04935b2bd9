"""How much the panels of a picture are alike, as the views of neighbouring cameras are."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter

from gaussray.prepare.panels.layout import PanelLayout


# Rows and columns to which a panel is reduced, and how far its likeness to the next one is sought:
# disparities of a sixth of the width, and rows that are off by a few hundredths of the height. What
# repeats does so at any phase: a quarter of the height.
_ROWS, _COLUMNS = 64, 96
_UP, _ACROSS = 3, 16
_FAR_UP = 16
# Details are what is left without a blur of this width, in reduced pixels.
_BLUR = 4.0
# Correlation of the details of two views: 0.74 and more for those of a stereo endoscope and for
# neighbours in a light field, at most 0.62 for the halves of an ordinary picture. In the shape of
# ordinary pictures two views are narrowed and rare, and chessboards reach 0.83.
ALIKE_VIEWS, VERY_ALIKE_VIEWS = 0.65, 0.9
# That of their details along the axis of the cut alone: edges across it continue in the other half
# of any picture, and reach 0.25 there.
ALIKE_ALONG = 0.4


class Likeness(NamedTuple):
    """How much two panels are alike.

    Args:
        whole: correlation of their details at the best shift.
        along: that of their details along the axis of the cut.
        is_repeated: of alike halves, whether those along the other axis are alike as well: the
            scene repeats itself (tiles, bricks, a chessboard).
    """

    whole: float
    along: float
    is_repeated: bool


def find_likeness(picture: UInt8[np.ndarray, "h w 3"], layout: PanelLayout) -> Likeness:
    """How much the first two panels of a layout are alike; 0 if they are small or plain.

    Args:
        picture: levels.
        layout: arrangement of panels.
    """
    axis = 1 if layout.columns > 1 else 0
    first, second = _pair(picture, axis, layout[axis])
    if not first.size:
        return Likeness(0.0, 0.0, False)
    whole, along = (
        _correlation(_details(first, axes), _details(second, axes)) for axes in ((0, 1), (axis,))
    )
    return Likeness(
        whole, along, whole >= ALIKE_VIEWS and _is_repeated(*_pair(picture, 1 - axis, 2))
    )


def _pair(
    picture: UInt8[np.ndarray, "h w 3"], axis: int, count: int
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]]:
    """The first two of so many parts along an axis, reduced; empty ones of a smaller picture."""
    part = picture.shape[axis] // count
    first, second = np.split(picture[..., 1].swapaxes(0, axis)[: 2 * part], 2)
    return _reduced(first.swapaxes(0, axis)), _reduced(second.swapaxes(0, axis))


def _reduced(panel: UInt8[np.ndarray, "h w"]) -> Float[np.ndarray, "rows columns"]:
    rows, columns = panel.shape[0] // _ROWS, panel.shape[1] // _COLUMNS
    blocks = panel[: rows * _ROWS, : columns * _COLUMNS].reshape(_ROWS, rows, _COLUMNS, columns)
    return blocks.mean(axis=(1, 3)) if rows and columns else np.zeros((0, 0))


def _is_repeated(
    first: Float[np.ndarray, "rows columns"], second: Float[np.ndarray, "rows columns"]
) -> bool:
    """Whether the details of two halves correlate at any shift."""
    if not first.size:
        return False
    both = (0, 1)
    return _correlation(_details(first, both), _details(second, both), _FAR_UP) >= ALIKE_VIEWS


def _details(
    panel: Float[np.ndarray, "rows columns"], axes: tuple[int, ...]
) -> Float[np.ndarray, "rows columns"]:
    return panel - gaussian_filter(panel, _BLUR, axes=axes)


def _correlation(
    first: Float[np.ndarray, "rows columns"],
    second: Float[np.ndarray, "rows columns"],
    most_up: int = _UP,
) -> float:
    """The largest normalised correlation of two panels over all shifts; 0 if one is plain."""
    rows, columns = first.shape
    best = 0.0
    for up in range(-most_up, most_up + 1):
        for across in range(-_ACROSS, _ACROSS + 1):
            a = first[max(up, 0) : rows + min(up, 0), max(across, 0) : columns + min(across, 0)]
            b = second[max(-up, 0) : rows - max(up, 0), max(-across, 0) : columns - max(across, 0)]
            a, b = a - a.mean(), b - b.mean()
            # Panels without details of a grey level correlate by their noise.
            if min(a.std(), b.std()) >= 1:
                best = max(best, float((a * b).mean() / (a.std() * b.std())))
    return best
