"""Matches of what is drawn over the pictures, as a logo is, and not of what the cameras see."""

from collections.abc import Collection, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from gaussray.capture.picture_file import read_levels
from gaussray.prepare.colmap import pycolmap
from gaussray.prepare.features import Keypoints, MatchingPicture, raw_matches, verified_matches
from gaussray.prepare.low_resolution import details_differ, low_details
from gaussray.prepare.missing_poses import FIRST_PAIR_AT_LAST


# A match lies at the same place in both pictures within so large a share of their width and height.
SAME_PLACE = 0.002
# Share of the matches at the same place from which on they decide about poses.
_MOST = 0.5
# Columns and rows of cells of a picture; a drawing lies in no more than such a share of the cells
# that as many matches all over the picture would lie in. A background too far away to move lies in
# more.
_CELLS, _SMALL = 16, 0.5
# What to do about a drawing.
WITHOUT_IT = "Mask it (masks and poses.masks=true, docs/prepare.md) or cut it off."


class PictureOverlay(NamedTuple):
    """Matches of two cameras, or of one camera's pictures, that are of a drawing over them.

    Args:
        cameras: names of the two cameras, twice the same of one alone.
        same: matches at the same place in two pictures that differ.
        total: all verified matches of these cameras.
    """

    cameras: tuple[str, str]
    same: int
    total: int

    @property
    def links_cameras(self) -> bool:
        """Whether the matches are of two cameras, and not of one alone."""
        return self.cameras[0] != self.cameras[1]

    @property
    def text(self) -> str:
        """What was found, in a sentence without its period."""
        share = f"{self.same} of {self.total} matches"
        if self.links_cameras:
            return f"{drawn_over_both(*self.cameras)} ({share})"
        return (
            f"{self.cameras[0]}: the pictures differ, but what they share lies in the same place "
            "in each: a logo or a counter drawn over them, or a background that stands still "
            f"({share})"
        )


def drawn_over_both(first: str, second: str) -> str:
    """What links two cameras by a drawing, in a sentence without its period.

    Args:
        first: name of one camera.
        second: name of the other.
    """
    return (
        f"{first} and {second} show different things, but what they share lies in the same place "
        "in both: a logo or a counter drawn over them"
    )


def at_same_place(
    first: Keypoints,
    second: Keypoints,
    rows: Int[np.ndarray, "m 2"],
    sizes: tuple[tuple[int, int], tuple[int, int]],
) -> Bool[np.ndarray, " m"]:
    """Which matches lie at the same place in both pictures, relative to their sizes.

    Args:
        first: keypoints of one picture.
        second: keypoints of the other.
        rows: matches, indices into `first` and `second`.
        sizes: columns and rows of each picture.
    """
    before = first.xy[rows[:, 0]] / np.array(sizes[0])
    after = second.xy[rows[:, 1]] / np.array(sizes[1])
    return np.linalg.norm(before - after, axis=1) < SAME_PLACE


def in_small_part(place: Float[np.ndarray, "m 2"]) -> bool:
    """Whether places, relative to the size of a picture, lie in a small part of it: in few cells
    beside as many places at random."""
    cells = np.clip((_CELLS * place).astype(int), 0, _CELLS - 1)
    held, every = len(np.unique(cells, axis=0)), _CELLS**2
    return held <= _SMALL * every * (1 - (1 - 1 / every) ** len(place))


def without_overlays(
    database: Path,
    folder: Path,
    pictures: Mapping[str, MatchingPicture],
    keypoints: Mapping[str, Keypoints],
) -> list[PictureOverlay]:
    """Take matches of drawings over the pictures out of a database, and tell of whose they are.

    They are at the same place in two pictures that differ at low resolution, in a small part of
    these. Two cameras, or one camera that moves, lose them if they are most of all their matches:
    else the others decide. A tripod's own pictures are not matched, and a copy's do not differ.

    Args:
        database: COLMAP database with verified matches. Pairs that lose matches lose their
            geometry, too; what is left of them has to be verified.
        folder: folder of the pictures.
        pictures: pictures by file.
        keypoints: their keypoints by file.
    """

    @cache
    def details(file: str):
        return low_details(read_levels(folder / file, *pictures[file].size))

    totals: dict[tuple[str, str], int] = {}
    found: dict[tuple[str, str], dict[tuple[str, str], int]] = {}
    for (a, b), rows in verified_matches(database).items():
        one, other = sorted((pictures[a].camera, pictures[b].camera))
        totals[one, other] = totals.get((one, other), 0) + len(rows)
        same = _same(a, b, rows, pictures, keypoints)
        count = int(same.sum())
        if count <= _MOST * len(rows):
            continue
        place = keypoints[a].xy[rows[same, 0]] / np.array(pictures[a].size)
        if in_small_part(place) and details_differ(details(a), details(b)):
            found.setdefault((one, other), {})[a, b] = count
    overlays = [
        PictureOverlay(cameras, same, totals[cameras])
        for cameras, pairs in found.items()
        if (same := sum(pairs.values())) > _MOST * totals[cameras]
    ]
    drawn = [pair for one in overlays for pair in found[one.cameras]]
    if drawn:
        _forget(database, drawn, pictures, keypoints)
    return overlays


def check_overlays(
    overlays: Collection[PictureOverlay], database: Path, pictures: Mapping[str, MatchingPicture]
) -> str:
    """What links cameras by a drawing alone, so that they cannot have poses; empty if nothing does.

    Args:
        overlays: those that were taken out of the matches.
        database: COLMAP database with the verified matches that are left.
        pictures: pictures by file.
    """
    several = [one for one in overlays if one.links_cameras]
    if not several:
        return ""
    best = max(
        (
            len(rows)
            for (a, b), rows in verified_matches(database).items()
            if pictures[a].camera != pictures[b].camera
        ),
        default=0,
    )
    return overlay_reason(several) if best < FIRST_PAIR_AT_LAST else ""


def overlay_reason(overlays: Collection[PictureOverlay]) -> str:
    """What is drawn over the pictures, and the remedy."""
    return f"{overlays_text(overlays)}. {WITHOUT_IT}"


def overlays_text(overlays: Collection[PictureOverlay]) -> str:
    """What is drawn over the pictures: that of most matches, and how many others there are."""
    worst = max(overlays, key=lambda one: one.same)
    others = len(overlays) - 1
    more = f" (and {others} other{'s' * (others > 1)} alike)" if others else ""
    return f"{worst.text}{more}"


def _same(
    first: str,
    second: str,
    rows: Int[np.ndarray, "m 2"],
    pictures: Mapping[str, MatchingPicture],
    keypoints: Mapping[str, Keypoints],
) -> Bool[np.ndarray, " m"]:
    sizes = pictures[first].size, pictures[second].size
    return at_same_place(keypoints[first], keypoints[second], rows, sizes)


def _forget(
    database: Path,
    pairs: Collection[tuple[str, str]],
    pictures: Mapping[str, MatchingPicture],
    keypoints: Mapping[str, Keypoints],
) -> None:
    """Leave pairs the matches that lie at different places, without a geometry."""
    raw = raw_matches(database)
    with pycolmap().Database.open(database) as db:
        numbers = {image.name: image.image_id for image in db.read_all_images()}
        for a, b in pairs:
            rows = raw[a, b][~_same(a, b, raw[a, b], pictures, keypoints)]
            first, second = numbers[a], numbers[b]
            db.delete_matches(first, second)
            db.delete_two_view_geometry(first, second)
            db.write_matches(first, second, rows.astype(np.uint32))
