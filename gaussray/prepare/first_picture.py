"""What the first picture of a video tells of it before anything else is done."""

from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from gaussray.prepare.panels.find import PanelSigns, panel_signs


# A block of so many pixels, squared, shows something if levels of one colour differ by this.
_BLOCK, _LEVELS = 16, 8


class FirstPicture(NamedTuple):
    """What is kept of the first picture of a video.

    Args:
        panels: what it shows of several views or maps in one picture.
        blocks: number of blocks that show something (`detailed_blocks`).
    """

    panels: tuple[PanelSigns, ...]
    blocks: int


def first_picture(picture: UInt8[np.ndarray, "h w 3"]) -> FirstPicture:
    """What is kept of the first picture of a video, upright."""
    return FirstPicture(panel_signs(picture), detailed_blocks(picture))


def detailed_blocks(picture: UInt8[np.ndarray, "h w 3"]) -> int:
    """The number of blocks of 16 x 16 pixels of a picture that are not plain."""
    height, width = (size - size % _BLOCK for size in picture.shape[:2])
    shape = height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK, 3
    blocks = picture[:height, :width].reshape(shape)
    spans = blocks.max(axis=(1, 3)) - blocks.min(axis=(1, 3))
    return int((spans.max(axis=-1) >= _LEVELS).sum())
