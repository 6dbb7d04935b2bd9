"""Layout of the window: one picture, two side by side, or two that share a frame."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8


# The configured camera, an ideal pinhole, or both.
LAYOUTS = ("camera", "pinhole", "side by side", "split")
# Colour around the pictures, on a dark page and on a light one.
BACKGROUND = {True: (20, 21, 23), False: (238, 240, 242)}


class Pane(NamedTuple):
    """A picture's rectangle in the window, in fractions of the window's width and height. Of the
    picture, the columns from the fraction `begin` to `end` are shown."""

    name: str
    left: float
    top: float
    width: float
    height: float
    begin: float = 0.0
    end: float = 1.0

    def pixel(self, position: tuple[float, float], size: tuple[int, int]) -> tuple[int, int] | None:
        """Column and row of the pixel at a position in the window; None where the pane does not
        show the picture.

        Args:
            position: fractions of the window's width, from the left, and height, from the top.
            size: width and height of the picture in pixels.
        """
        x, y = (position[0] - self.left) / self.width, (position[1] - self.top) / self.height
        if not (self.begin <= x < self.end and 0 <= y < 1):
            return None
        return int(x * size[0]), int(y * size[1])


def panes(layout: str, window: float, picture: float, split: float = 0.5) -> list[Pane]:
    """The panes of a layout, as large as the window allows and centred in their part of it.

    Args:
        layout: one of `LAYOUTS`.
        window: aspect of the window, width / height.
        picture: aspect of the pictures, width / height.
        split: in the split layout, the fraction of the width left of which the pinhole is shown.

    Raises:
        ValueError: there is no such layout.
    """
    if layout not in LAYOUTS:
        raise ValueError(f"the layout must be one of {', '.join(LAYOUTS)}, got {layout!r}.")
    if layout == "side by side":
        width, height = _within(window / 2, picture)
        return [
            Pane(name, begin + (1 - width) / 4, (1 - height) / 2, width / 2, height)
            for name, begin in (("pinhole", 0.0), ("camera", 0.5))
        ]
    width, height = _within(window, picture)
    whole = (1 - width) / 2, (1 - height) / 2, width, height
    if layout == "split":
        return [Pane("pinhole", *whole, 0.0, split), Pane("camera", *whole, split, 1.0)]
    return [Pane(layout, *whole)]


def compose_window(
    pictures: Sequence[tuple[Pane, UInt8[np.ndarray, "h w 3"]]], window: float, dark: bool
) -> UInt8[np.ndarray, "H W 3"]:
    """The window's image: pictures in their panes, without resampling.

    Args:
        pictures: panes with their pictures, 8-bit sRGB levels, all of one size.
        window: aspect of the window, width / height.
        dark: whether the page, and so the surroundings of the pictures, are dark.
    """
    pane, picture = pictures[0]
    width = max(round(picture.shape[1] / pane.width), picture.shape[1])
    height = max(round(width / window), 1)
    # Rounding must not cut a row off the side that fits exactly.
    height = max(height, picture.shape[0])
    sheet = np.empty((height, width, 3), np.uint8)
    sheet[:] = BACKGROUND[dark]
    for pane, picture in pictures:
        h, w = picture.shape[:2]
        left = min(round(pane.left * width), width - w)
        top = min(round(pane.top * height), height - h)
        first, last = round(pane.begin * w), round(pane.end * w)
        sheet[top : top + h, left + first : left + last] = picture[:, first:last]
    if len(pictures) == 2 and pictures[0][0].end == 1:
        sheet[:, width // 2 - 1 : width // 2 + 1] = BACKGROUND[dark]
    elif len(pictures) == 2 and pictures[0][0].end > 0:
        pane, picture = pictures[0]
        edge = round(pane.left * width) + round(pane.end * picture.shape[1])
        top = min(round(pane.top * height), height - picture.shape[0])
        sheet[top : top + picture.shape[0], min(edge, width - 1)] = 255
    return sheet


def window_fov(fov: float, window: float, picture: float) -> float:
    """Vertical field of view, in radians, of a window with a pinhole picture in its middle.

    Args:
        fov: horizontal field of view of the picture, in degrees.
        window: aspect of the window, width / height.
        picture: aspect of the picture, width / height.
    """
    slope = np.tan(np.deg2rad(fov) / 2)
    rise = slope / picture if window >= picture else slope / window
    return float(2 * np.arctan(rise))


def _within(window: float, picture: float) -> tuple[float, float]:
    """Fractions of the window's width and height that a picture fills."""
    return (picture / window, 1.0) if window >= picture else (1.0, window / picture)
