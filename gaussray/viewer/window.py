"""Pictures in a window: one, two beside each other, or two that share a frame."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8


# What the window shows of the camera (effect) and of an ideal pinhole.
LAYOUTS = ("effect", "pinhole", "side by side", "split")
# Around pictures, in dark colours and in light ones.
AROUND = {True: (20, 21, 23), False: (238, 240, 242)}


class Pane(NamedTuple):
    """A picture's place in the window, in shares of its width and height; of it, the columns from
    the share `begin` to `end` are shown there."""

    name: str
    left: float
    top: float
    width: float
    height: float
    begin: float = 0.0
    end: float = 1.0

    def pixel(self, place: tuple[float, float], size: tuple[int, int]) -> tuple[int, int] | None:
        """Column and row of the picture at a place of the window; None if it is not shown there."""
        x, y = (place[0] - self.left) / self.width, (place[1] - self.top) / self.height
        if not (self.begin <= x < self.end and 0 <= y < 1):
            return None
        return int(x * size[0]), int(y * size[1])


def panes(layout: str, window: float, picture: float, split: float = 0.5) -> list[Pane]:
    """Where the pictures of a layout are: as large as the window allows, in the middle of their
    part. `window` and `picture` are width over height; split, the pinhole is at the left of the
    share `split`."""
    if layout not in LAYOUTS:
        raise ValueError(f"the layout must be one of {', '.join(LAYOUTS)}, got {layout!r}.")
    if layout == "side by side":
        width, height = _within(window / 2, picture)
        return [
            Pane(name, begin + (1 - width) / 4, (1 - height) / 2, width / 2, height)
            for name, begin in (("pinhole", 0.0), ("effect", 0.5))
        ]
    width, height = _within(window, picture)
    whole = (1 - width) / 2, (1 - height) / 2, width, height
    if layout == "split":
        return [Pane("pinhole", *whole, 0.0, split), Pane("effect", *whole, split, 1.0)]
    return [Pane(layout, *whole)]


def composed(
    shown: Sequence[tuple[Pane, UInt8[np.ndarray, "h w 3"]]], window: float, dark: bool
) -> UInt8[np.ndarray, "H W 3"]:
    """The window with pictures of one size in their panes, pixel by pixel as they are."""
    pane, picture = shown[0]
    width = max(round(picture.shape[1] / pane.width), picture.shape[1])
    height = max(round(width / window), 1)
    # The one side that fits exactly shall not lose a row to rounding.
    height = max(height, picture.shape[0])
    sheet = np.empty((height, width, 3), np.uint8)
    sheet[:] = AROUND[dark]
    for pane, picture in shown:
        h, w = picture.shape[:2]
        left = min(round(pane.left * width), width - w)
        top = min(round(pane.top * height), height - h)
        first, last = round(pane.begin * w), round(pane.end * w)
        sheet[top : top + h, left + first : left + last] = picture[:, first:last]
    if len(shown) == 2 and shown[0][0].end == 1:
        sheet[:, width // 2 - 1 : width // 2 + 1] = AROUND[dark]
    elif len(shown) == 2 and shown[0][0].end > 0:
        pane, picture = shown[0]
        edge = round(pane.left * width) + round(pane.end * picture.shape[1])
        top = min(round(pane.top * height), height - picture.shape[0])
        sheet[top : top + picture.shape[0], min(edge, width - 1)] = 255
    return sheet


def field_of_window(field: float, window: float, picture: float) -> float:
    """Vertical field of view, in radians, of a window in whose middle a pinhole's picture of this
    horizontal field (degrees) lies."""
    slope = np.tan(np.deg2rad(field) / 2)
    rise = slope / picture if window >= picture else slope / window
    return float(2 * np.arctan(rise))


def _within(window: float, picture: float) -> tuple[float, float]:
    """Shares of a window that a picture fills."""
    return (picture / window, 1.0) if window >= picture else (1.0, window / picture)
