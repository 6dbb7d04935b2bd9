"""Epipolar lines: where the poses say that a point of one picture lies in another."""

import dataclasses

import numpy as np
from jaxtyping import Float

from gaussray.capture.spread import evenly_spread
from gaussray.geometry import epipolar_angle
from gaussray.prepare.placement import Placement
from gaussray.prepare.pose_math import camera_centre
from gaussray.prepare.sparse_model import pixel_rays, project_points


# Lines drawn for each pair of pictures, and points of each line.
LINES, _SAMPLES = 8, 400
# Depths of a line's points, in distances between the two cameras.
_NEAREST, _FARTHEST = 0.02, 200.0


@dataclasses.dataclass(frozen=True, eq=False)
class EpipolarPair:
    """Two pictures and how far their matches are from the epipolar lines.

    Args:
        first: file of the first picture.
        second: file of the second one.
        count: number of matches.
        median: median distance of the second picture's matches from the lines, in pixels.
        points: pixels of `LINES` matches in both pictures, and the timestamp of each.
        lines: the line of each in the second picture; NaN separates its parts.
    """

    first: str
    second: str
    count: int
    median: float
    points: list[tuple[np.ndarray, np.ndarray, int]]
    lines: list[Float[np.ndarray, "n 2"]]


def epipolar_pairs(placement: Placement, most: int) -> list[EpipolarPair]:
    """For each registered picture the pair with the partner with which it shares most matches.

    Args:
        placement: registered pictures, keypoints and matches.
        most: largest number of pairs; of more, an even share is taken.
    """
    model = placement.model
    index = {name: k for k, name in enumerate(model.pictures)}
    partners: dict[str, tuple[int, tuple[str, str]]] = {}
    for pair, rows in placement.matches.items():
        if not all(name in index for name in pair):
            continue
        for name in pair:
            partners[name] = max(partners.get(name, (0, pair)), (len(rows), pair))
    chosen = list(dict.fromkeys(pair for _, pair in partners.values()))
    return [_pair(placement, first, second, index) for first, second in evenly_spread(chosen, most)]


def epipolar_distance(
    placement: Placement, first: str, second: str, index: dict[str, int]
) -> Float[np.ndarray, " matches"]:
    """Distance in pixels of each match of the second picture from its epipolar line.

    The angle between the second ray and the plane of the first ray and both cameras, times the
    focal length: at the picture's centre these are pixels, through any lens.

    Args:
        placement: poses, lenses, keypoints and matches.
        first: file of the first picture.
        second: file of the second one; the pair is a key of `placement.matches`.
        index: place of each registered file in `placement.model.pictures`.

    Returns:
        The distances, NaN where a lens has no ray at a keypoint.
    """
    a, b = index[first], index[second]
    model, rows = placement.model, placement.matches[first, second]
    turn_a, turn_b = model.poses[a, :, :3], model.poses[b, :, :3]
    ray_a = pixel_rays(model.lenses[a], placement.keypoints[first].xy[rows[:, 0]]) @ turn_a
    ray_b = pixel_rays(model.lenses[b], placement.keypoints[second].xy[rows[:, 1]]) @ turn_b
    centre_a, centre_b = camera_centre(model.poses[[a, b]])
    return epipolar_angle(ray_a, ray_b, centre_b - centre_a) * model.lenses[b]["fl_x"]


def _pair(placement: Placement, first: str, second: str, index: dict[str, int]) -> EpipolarPair:
    distance = epipolar_distance(placement, first, second, index)
    rows = placement.matches[first, second]
    left, right = placement.keypoints[first], placement.keypoints[second]
    chosen = _spread(left.xy[rows[:, 0]], LINES)
    points, lines = [], []
    for k in chosen:
        i, j = rows[k]
        points.append((left.xy[i], right.xy[j], int(left.instant[i])))
        lines.append(_line(placement, index[first], index[second], left.xy[i]))
    finite = distance[np.isfinite(distance)]
    median = float(np.median(finite)) if len(finite) else float("nan")
    return EpipolarPair(first, second, len(rows), median, points, lines)


def _line(placement: Placement, a: int, b: int, pixel: np.ndarray) -> Float[np.ndarray, "n 2"]:
    """The ray of a pixel as the second camera sees it, NaN outside of its picture."""
    model = placement.model
    direction = pixel_rays(model.lenses[a], pixel[None])[0] @ model.poses[a, :, :3]
    centre, other = camera_centre(model.poses[[a, b]])
    depth = np.geomspace(_NEAREST, _FARTHEST, _SAMPLES) * np.linalg.norm(other - centre)
    lens = model.lenses[b]
    pixels, _ = project_points(lens, model.poses[b], centre + depth[:, None] * direction)
    with np.errstate(invalid="ignore"):
        size = np.array([lens["w"], lens["h"]])
        inside = np.all((pixels >= 0) & (pixels <= size), axis=1)
    return np.where(inside[:, None], pixels, np.nan)


def _spread(xy: Float[np.ndarray, "n 2"], count: int) -> list[int]:
    """Indices of points that are far from each other, the one next to the middle first."""
    chosen = [int(np.linalg.norm(xy - np.median(xy, axis=0), axis=1).argmin())]
    far = np.linalg.norm(xy - xy[chosen[0]], axis=1)
    while len(chosen) < min(count, len(xy)):
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(xy - xy[chosen[-1]], axis=1))
    return chosen
