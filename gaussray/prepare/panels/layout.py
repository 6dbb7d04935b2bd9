"""Arrangements of several panels in one picture: their names, pixels, and the commands that cut."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from shlex import quote
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8


_NAMES = {
    2: (("upper", "lower"), ("left", "right")),
    3: (("upper", "middle", "lower"), ("left", "middle", "right")),
}
_COUNTS = {2: "two", 3: "three", 4: "four"}


class PanelLayout(NamedTuple):
    """Panels of one size: so many rows of them, and so many in a row."""

    rows: int
    columns: int

    @property
    def names(self) -> list[str]:
        """What each panel is called, row by row."""
        down, across = (
            [""] if n == 1 else _NAMES[n][axis] if n in _NAMES else [str(k + 1) for k in range(n)]
            for axis, n in enumerate(self)
        )
        return ["_".join(filter(None, (a, b))) for a in down for b in across]

    def told(self, what: str) -> str:
        """Such as `three views side by side`.

        Args:
            what: what the panels are, in the plural.
        """
        if self.rows > 1 and self.columns > 1:
            return f"{self.rows} x {self.columns} {what}"
        way = "side by side" if self.rows == 1 else "one above the other"
        return f"{_COUNTS[self.rows * self.columns]} {what} {way}"

    def panels(self, picture: UInt8[np.ndarray, "h w 3"]) -> Iterator[UInt8[np.ndarray, "y x 3"]]:
        """The panels of a picture, row by row."""
        height, width = picture.shape[:2]
        for j in range(self.rows):
            for i in range(self.columns):
                yield picture[
                    height * j // self.rows : height * (j + 1) // self.rows,
                    width * i // self.columns : width * (i + 1) // self.columns,
                ]

    def commands(self, path: Path, kept: Sequence[int], stretch: bool) -> list[str]:
        """The commands that cut panels out of a video into files named as it and the panel.

        Args:
            path: the video.
            kept: indices of the panels.
            stretch: whether panels have been narrowed to fit, and are widened again.
        """
        wide, high = _part("iw", 1, self.columns), _part("ih", 1, self.rows)
        scale = f",scale={self.columns}*iw:{self.rows}*ih".replace("1*", "") if stretch else ""
        commands = []
        for k in kept:
            j, i = divmod(k, self.columns)
            place = f"{_part('iw', i, self.columns)}:{_part('ih', j, self.rows)}"
            target = quote(f"{path.stem}_{self.names[k]}.mp4")
            crop = f"-vf crop={wide}:{high}:{place}{scale}"
            commands.append(f"`ffmpeg -i {quote(str(path))} {crop} {target}`")
        return commands


def _part(side: str, k: int, count: int) -> str:
    """The k-th of so many parts of a side, in the language of ffmpeg's filters."""
    if not k:
        return "0"
    return ("" if k == 1 else f"{k}*") + (side if count == 1 else f"{side}/{count}")


# Larger ones first: cuts at quarters are also a cut at the half.
PANEL_LAYOUTS = (
    PanelLayout(2, 2),
    PanelLayout(1, 4),
    PanelLayout(1, 3),
    PanelLayout(3, 1),
    PanelLayout(1, 2),
    PanelLayout(2, 1),
)
