"""Finds which videos seem to hold several panels in each picture, and says how to cut them."""

import dataclasses
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gaussray.capture.errors import CaptureWarning
from gaussray.prepare.panels.layout import PANEL_LAYOUTS, PanelLayout
from gaussray.prepare.panels.likeness import (
    ALIKE_ALONG,
    ALIKE_VIEWS,
    VERY_ALIKE_VIEWS,
    Likeness,
    find_likeness,
)
from gaussray.prepare.panels.map_panels import picture_panels
from gaussray.prepare.panels.seams import Seams, find_seams


# Shares of a cut that are a seam: at most 0.26 in several hundred photographs, 0.5 and more between
# unlike panels. Other lines must be less than half as clear: door frames and bars have several.
_SEAM, _OTHER = 0.4, 0.5
# So many times as wide as high, or as high as wide, a picture of a camera is rare.
_UNUSUAL = 2.2
# Panels in a usual shape are either maps beside pictures, or alike.
_RATHER_ALIKE = 0.5
# Beside a video that holds panels, another one of the same size holds them if it shows this much.
_BESIDE_SEAM, _BESIDE_ALIKE, _BESIDE_ALONG = 0.15, 0.4, 0.3
# Of panels without a seam that is worth a look.
_UNLIKE = Likeness(0.0, 0.0, False)


@dataclasses.dataclass(frozen=True)
class PanelSigns:
    """What a picture shows of a layout.

    Args:
        layout: the arrangement of panels.
        size: columns and rows of the picture.
        seams: how much of each cut is a seam.
        likeness: how much the first two panels are alike.
        pictures: indices of the panels that are pictures; fewer than all if the others are maps.
    """

    layout: PanelLayout
    size: tuple[int, int]
    seams: Seams
    likeness: Likeness
    pictures: tuple[int, ...]

    @property
    def has_maps(self) -> bool:
        """Whether some panels are maps and others pictures."""
        return len(self.pictures) < self.layout.rows * self.layout.columns

    @property
    def are_alike(self) -> bool:
        """Whether the picture is of two views of one scene.

        From 2:1 on, or higher than wide, they need be less alike than in the shape of an ordinary
        picture, into which they are narrowed.
        """
        if sorted(self.layout) != [1, 2] or self.likeness.is_repeated:
            return False
        least = VERY_ALIKE_VIEWS if self._is_usual_of_two else ALIKE_VIEWS
        return self.likeness.whole >= least and self.likeness.along >= ALIKE_ALONG

    @property
    def is_narrowed(self) -> bool:
        """Whether views have been narrowed to fit into a picture of an ordinary shape."""
        return self.are_alike and self._is_usual_of_two

    @property
    def _is_usual_of_two(self) -> bool:
        width, height = self.size
        return width < 2 * height if self.layout.columns > 1 else height <= width

    @property
    def are_surely_views(self) -> bool:
        """Whether the picture is of two views by two signs: they are alike, and a clear seam, the
        only one, is between them."""
        cuts = self.seams.cuts
        return self.are_alike and min(cuts) >= _SEAM and self.seams.other <= _OTHER * min(cuts)

    @property
    def are_panels(self) -> bool:
        """Whether the picture seems to be of several panels, from what it shows itself."""
        if self.are_alike:
            return True
        cuts, usual = self.seams.cuts, max(self.size) < _UNUSUAL * min(self.size)
        if self.has_maps and not usual:
            # Maps may be black on both sides of a cut.
            cuts = self._cuts_beside_pictures()
        if not cuts or min(cuts) < _SEAM or self.seams.other > _OTHER * min(cuts):
            return False
        grid = min(self.layout) > 1
        return not usual or grid or self.has_maps or self.likeness.whole >= _RATHER_ALIKE

    def _cuts_beside_pictures(self) -> tuple[float, ...]:
        """The cuts between two panels of which one at least is a picture."""
        if min(self.layout) > 1:
            return self.seams.cuts
        shown = {k + side for k in self.pictures for side in (-1, 0)}
        return tuple(share for k, share in enumerate(self.seams.cuts) if k in shown)

    def are_beside(self, others: Sequence["PanelSigns"]) -> bool:
        """Whether the picture seems to be of several panels, as others of its size are.

        Args:
            others: what the other videos hold.
        """
        if not any((other.layout, other.size) == (self.layout, self.size) for other in others):
            return False
        whole, along, _ = self.likeness
        alike = whole >= _BESIDE_ALIKE and along >= _BESIDE_ALONG
        return alike or min(self.seams.cuts) >= _BESIDE_SEAM


def panel_signs(picture: UInt8[np.ndarray, "h w 3"]) -> tuple[PanelSigns, ...]:
    """What a picture shows of each layout that may be in it."""
    return tuple(_signs(picture, layout) for layout in PANEL_LAYOUTS)


def _signs(picture: UInt8[np.ndarray, "h w 3"], layout: PanelLayout) -> PanelSigns:
    height, width = picture.shape[:2]
    seams = find_seams(picture, layout)
    likeness, pictures = _UNLIKE, tuple(range(layout.rows * layout.columns))
    shown = max(seams.cuts, default=0.0) >= _BESIDE_SEAM
    if shown or sorted(layout) == [1, 2]:
        likeness = find_likeness(picture, layout)
    if shown:
        pictures = picture_panels(picture, layout)
    return PanelSigns(layout, (width, height), seams, likeness, pictures)


def find_panels(signs: Sequence[Sequence[PanelSigns]]) -> list[PanelSigns | None]:
    """The panels that each of several videos seems to hold, None of a single view.

    Where one does, less is asked of the others of its size, which came from the same program.

    Args:
        signs: for each video what its first picture shows of each layout (`panel_signs`).
    """
    found = [next((one for one in own if one.are_panels), None) for own in signs]
    sure = [one for one in found if one is not None]
    return [
        one if one is not None else next((s for s in own if s.are_beside(sure)), None)
        for one, own in zip(found, signs, strict=True)
    ]


def warn_of_panels(paths: Sequence[Path], signs: Sequence[Sequence[PanelSigns]]) -> None:
    """Warn of the videos that seem to hold several panels, and tell how to cut each.

    Args:
        paths: the videos.
        signs: for each video what its first picture shows of each layout (`panel_signs`).
    """
    for path, found in zip(paths, find_panels(signs), strict=True):
        if found is not None:
            warnings.warn(_message(path, found), CaptureWarning, stacklevel=4)


def _message(path: Path, found: PanelSigns) -> str:
    commands = found.layout.commands(path, found.pictures, found.is_narrowed)
    cut = ", ".join(commands[:-1]) + " and " * (len(commands) > 1) + commands[-1]
    those, are = ("these", "them") if len(commands) > 1 else ("this", "it")
    if found.has_maps:
        names = " and ".join(found.layout.names[k] for k in found.pictures)
        what = (
            f"{found.layout.told('panels')}, of which only the {names} one"
            f"{'s are' if len(commands) > 1 else ' is'} coloured as a picture (the others may be "
            "depth maps or masks)"
        )
    else:
        what = found.layout.told("views")
    return (
        f"{path}: the picture looks like {what}, but the video of a camera must hold one view. "
        f"Cut {are} out by {cut}, and put {those} in its place (or leave it, if it is one)."
    )
