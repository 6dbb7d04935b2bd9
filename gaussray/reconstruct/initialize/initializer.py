"""Which points the first Gaussians stand on: an initialiser, chosen by what the capture holds."""

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureWarning
from gaussray.capture.points import Points
from gaussray.geometry import rotation_matrix
from gaussray.reconstruct.data.backdrop import backdrop_of
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.initialize.from_points import (
    between,
    in_common_view,
    inliers,
    merged,
    typical_gap,
)
from gaussray.reconstruct.initialize.stereo.from_pictures import points_from_pictures
from gaussray.reconstruct.initialize.stereo.guess import guessed_points
from gaussray.reconstruct.initialize.stereo.uncovered import VIEWS, coverage, uncovered_points
from gaussray.reconstruct.initialize.stereo.view_sets import first_views, still_views
from gaussray.reconstruct.options import FitOptions
from gaussray.runtime.progress import ProgressReport, no_report


# Points of stereo below which the pictures do not overlap.
FEWEST = 100
# Share of the pictures' cells in which given points lie, from which on they are enough.
COVERED = 0.8


class InitialPoints(NamedTuple):
    """The points that the first Gaussians stand on.

    Args:
        position: places in the world.
        color: linear light.
        on_surfaces: whether the points lie on surfaces: given and matched ones do, those at random
            places or guessed distances do not. Then the pictures tell from the start which points
            move, connected groups of these are rigid bodies, random Gaussians are added around the
            points, and the Gaussians on the points stay in the scene even if no training ray meets
            them.
    """

    position: Float[np.ndarray, "points 3"]
    color: Float[np.ndarray, "points 3"]
    on_surfaces: bool


def initial_points(
    capture: Capture,
    footage: Footage,
    options: FitOptions,
    progress: Callable[[str], ProgressReport],
) -> InitialPoints:
    """The points that the first Gaussians stand on, as fit.start says: those of the capture, those
    that stereo finds in the pictures, or random ones.

    With `auto`, points of the capture that leave much of the pictures empty are filled up by
    stereo. Without any, and with fewer than FEWEST of stereo, they are at guessed distances.

    Args:
        capture: the capture, with or without points of its own.
        footage: the training pictures and their cameras.
        options: source and number of the points, outliers, and what shows motion: if transient
            Gaussians do, stereo leaves out what moves.
        progress: returns what shows the progress of a piece of work, whose name it is told.
    """
    given, start = capture.points, options.start
    if start == "random" or (start == "given" and given is None):
        return points_in_view(footage, options)
    known = None if start == "stereo" else given
    if known is not None and (start == "given" or covers(known, footage, options)):
        return points_of_capture(known, options)
    matched = points_of_stereo(footage, options, known, progress("stereo"))
    more = progress("uncovered places")
    if known is not None:
        return points_of_capture(filled_up(known, matched), options, footage, report=more)
    if len(matched.position) < FEWEST:
        warnings.warn(
            f"stereo finds {len(matched.position)} points in the pictures: the start is points of "
            "their colours at guessed distances. Pictures that overlap, of a textured scene, have "
            "thousands.",
            CaptureWarning,
            stacklevel=2,
        )
        return points_at_guessed_distances(footage, options)
    return points_of_capture(matched, options, footage, given=False, report=more)


def points_of_capture(
    points: Points,
    options: FitOptions,
    footage: Footage | None = None,
    *,
    given: bool = True,
    report: ProgressReport = no_report,
) -> InitialPoints:
    """Points on surfaces without duplicates and outliers, at least fit.points of them.

    Args:
        points: given or matched points.
        options: fit.points, fit.outliers and fit.seed. If there are fewer than fit.points, the
            missing ones are put between them.
        footage: pictures in which points are added where something is shown but no point lies
            (`uncovered_points`); None adds none.
        given: whether any of the points come with the capture: a warning says how many are left
            out. Stereo always finds some wrong ones.
        report: called with the number of pictures in which points were added, and of all.
    """
    position, color = cleaned(points, options.outliers, warn=given)
    if footage is not None:
        added = uncovered_points(
            still_views(footage),
            position,
            count=options.points,
            seed=options.seed,
            plain=backdrop_of(footage),
            report=report,
        )
        position = np.concatenate([position, added.position])
        color = np.concatenate([color, added.color])
    missing = max(options.points - len(position), 0) if len(position) else 0
    more = between(position, color, count=missing, seed=options.seed)
    place, light = (np.concatenate(x) for x in zip((position, color), more, strict=True))
    return InitialPoints(place, light, on_surfaces=True)


def covers(known: Points, footage: Footage, options: FitOptions) -> bool:
    """Whether points lie in at least COVERED of the pictures' cells.

    Points of a mesh do; those of COLMAP leave walls, ground and sky empty however many they are.

    Args:
        known: points of the capture.
        footage: the training pictures and their cameras.
        options: fit.points is about how many cells all pictures have together.
    """
    seen = first_views(footage, VIEWS)
    plain = backdrop_of(footage)
    return coverage(seen, known.position, count=options.points, plain=plain) >= COVERED


def points_in_view(footage: Footage, options: FitOptions) -> InitialPoints:
    """Random grey points where the cameras look (`in_common_view`).

    Args:
        footage: the training pictures, of which only the cameras count.
        options: fit.points and fit.seed.
    """
    pose = footage.camera.trajectory
    origin = np.asarray(pose.translation)[:, 0]
    axis = np.asarray(rotation_matrix(pose.quat[:, 0])[:, :, 2])
    points = in_common_view(origin, axis, count=options.points, seed=options.seed)
    return InitialPoints(*points, on_surfaces=False)


def points_at_guessed_distances(footage: Footage, options: FitOptions) -> InitialPoints:
    """Points of the pictures' colours where other pictures show these too (`guessed_points`);
    random ones where the pictures show nothing.

    Args:
        footage: the training pictures and their cameras.
        options: fit.points and fit.seed.
    """
    guessed = guessed_points(
        still_views(footage), count=options.points, seed=options.seed, plain=backdrop_of(footage)
    )
    if not len(guessed.position):
        return points_in_view(footage, options)
    return InitialPoints(guessed.position, guessed.color, on_surfaces=False)


def points_of_stereo(
    footage: Footage, options: FitOptions, known: Points | None, report: ProgressReport
) -> Points:
    """The points that stereo finds in the training pictures.

    Args:
        footage: the training pictures and their cameras.
        options: without a deformation (fit.motion) what moves gets no points.
        known: points of the capture, which narrow the distances down; None if there are none.
        report: called after every step.
    """
    return points_from_pictures(footage, known=known, moving=options.deforms, report=report)


def filled_up(known: Points, matched: Points) -> Points:
    """Known points, and those of stereo where the known ones leave surfaces empty.

    Args:
        known: points of the capture; all are kept.
        matched: points of stereo; those are added that lie further from all known ones than
            typically from each other.
    """
    if len(matched.position) < 2:
        return known
    gap = typical_gap(matched.position)
    away, _ = KDTree(known.position).query(matched.position, workers=-1)
    more = away > gap
    return Points(
        np.concatenate([known.position, matched.position[more]]),
        np.concatenate([known.color, matched.color[more]]),
    )


def cleaned(
    points: Points, limit: float, *, warn: bool = True
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
    """Positions and colours of the points without duplicates and outliers.

    Args:
        points: given or matched points.
        limit: standard deviations from which on a point is far from its neighbours (`inliers`); 0
            keeps outliers.
        warn: whether a warning says how many are left out.
    """
    count = len(points.position)
    position, color = merged(np.asarray(points.position), np.asarray(points.color))
    keep = inliers(position, limit) if limit else np.ones(len(position), bool)
    if warn and (not keep.all() or len(keep) < count):
        warnings.warn(
            f"of {count} starting points, {count - len(keep)} at the place of another and "
            f"{int((~keep).sum())} far from all others are left out. fit.outliers=0 keeps the "
            "latter.",
            CaptureWarning,
            stacklevel=3,
        )
    return position[keep], color[keep]
