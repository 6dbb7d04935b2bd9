"""Points from the training pictures of a capture: of what stands still, and of what moves at given
timestamps with its velocities."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from gaussray.capture.points import Points
from gaussray.reconstruct.data.backdrop import BackdropColor, backdrop_of, like_backdrop
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.still_cameras import (
    MedianMasks,
)
from gaussray.reconstruct.initialize.stereo.carving import contradicted
from gaussray.reconstruct.initialize.stereo.matching import reduced_mask, reduction, stereo_points
from gaussray.reconstruct.initialize.stereo.options import (
    StereoOptions,
    options_for,
    with_silhouette,
)
from gaussray.reconstruct.initialize.stereo.points import StereoPoints, no_points
from gaussray.reconstruct.initialize.stereo.silhouette import silhouette_points
from gaussray.reconstruct.initialize.stereo.velocity import point_motion
from gaussray.reconstruct.initialize.stereo.view_sets import (
    MovingPixels,
    moving_views,
    small_views,
    some_views,
    still_views,
)
from gaussray.reconstruct.initialize.stereo.views import stereo_views
from gaussray.runtime.progress import ProgressReport, no_report
from gaussray.runtime.side_by_side import mapped_in_threads


# Residual of a registration from which on a velocity is not believed.
_BELIEVED = 2.0
# Points of what moves per moving pixel of a picture, below which silhouettes fill up.
_ENOUGH = 0.25


class MovingPoints(NamedTuple):
    """Points of what moves at one timestamp.

    Args:
        points: the points.
        time: the timestamp, in the capture's unit.
        velocity: in scene units per unit of time.
        residual: of the registration that found the velocity (`PointMotion`; 3: lost).
    """

    points: StereoPoints
    time: float
    velocity: Float[np.ndarray, "points 3"]
    residual: Float[np.ndarray, " points"]

    @property
    def believed(self) -> Bool[np.ndarray, " points"]:
        """Which points have a velocity that is believed."""
        return self.residual < _BELIEVED


def points_from_pictures(
    footage: Footage,
    *,
    options: StereoOptions | None = None,
    known: Points | None = None,
    moving: bool = True,
    report: ProgressReport = no_report,
) -> Points:
    """Points of the surfaces that training pictures show: of all that stands still, and of what
    moves as it is at the first timestamp.

    Args:
        footage: the training pictures and their cameras.
        options: None chooses by device and number of views.
        known: points that are there already (of a structure from motion, say): they narrow the
            distances down.
        moving: whether what moves gets points, too.
        report: called with the number of steps done and their total: one for each picture that is
            matched, and a few for what takes less time.

    Returns:
        Positions in the world and linear colours; none where fewer than two views overlap.
    """
    still = still_views(footage)
    if options is None:
        pixels = still.pictures[..., 0].size if len(np.unique(footage.times)) == 1 else 0
        options = options_for(jax.default_backend(), len(still.frames), still_pixels=pixels)
    still = some_views(still, options.views)
    position = None if known is None else known.position
    first = None
    if moving:
        first = moving_views(footage, float(footage.times.min()), MedianMasks(footage))
    pictures = len(still.frames) if len(still.frames) > 1 else 0
    # After matching, one step confirms, and one compares colours (of what stands still).
    still_steps = pictures + 2 if pictures else 0
    steps = still_steps + (0 if first is None else len(first[0].frames) + 1)
    if steps:
        report(0, steps, "loads or compiles its programs")
    parts = []
    if pictures:
        matched = stereo_points(
            *still[:1],
            still.cameras,
            still.masks,
            options=options,
            known=position,
            report=lambda done: report(done, steps),
        )
        matched = _before_backdrop(matched, backdrop_of(footage))
        wrong = contradicted(small_views(still), matched.position, matched.color)
        report(still_steps, steps)
        parts.append(StereoPoints(*(x[~wrong] for x in matched)))
    if first is not None:
        parts.append(
            _moving(
                *first,
                options,
                report=lambda done: report(still_steps + done, steps),
            )
        )
    found = StereoPoints(*(np.concatenate(x) for x in zip(no_points(), *parts, strict=True)))
    return Points(found.position.astype(np.float32), found.light.astype(np.float32))


def _before_backdrop(points: StereoPoints, plain: BackdropColor | None) -> StereoPoints:
    """The points that do not have the colour of a plain backdrop. Points that do match anywhere in
    the air: pictures on all sides show that colour."""
    if plain is None:
        return points
    return StereoPoints(*(x[~like_backdrop(points.color, plain)] for x in points))


def moving_points(
    footage: Footage,
    times: Sequence[float],
    *,
    moved: MovingPixels | None = None,
    options: StereoOptions | None = None,
    known: Float[np.ndarray, "known 3"] | None = None,
    alone: Callable[[int], StereoPoints] | None = None,
    report: ProgressReport = no_report,
) -> list[MovingPoints]:
    """Points of what moves at each timestamp, with velocities towards the next one (for the last,
    from the one before).

    Args:
        footage: the training pictures and their cameras.
        times: the timestamps, in the capture's unit; one has no points unless two of its pictures
            show that something moves, or one does and `alone` is given.
        moved: which pixels of a frame move; None compares with the temporal medians of the cameras
            that stand still.
        options: how carefully to match; None chooses by device and number of cameras.
        known: points of the scene; they narrow the distances down.
        alone: points of what moves in a frame, where no other frame of its timestamp shows it;
            None: there are none.
        report: called with the number of steps done and their total, two for each timestamp.
    """
    moved = moved or MedianMasks(footage)
    options = options or options_for(jax.default_backend(), len(np.unique(footage.name)))

    def cloud_at(time: float) -> StereoPoints:
        views = moving_views(footage, float(time), moved)
        if views is not None:
            return _moving(*views, options, known=known)
        return _alone(footage, float(time), moved, alone)

    def motion_of(k: int) -> tuple[np.ndarray, np.ndarray]:
        other = k + 1 if k + 1 < len(clouds) else k - 1
        if not 0 <= other < len(clouds):
            return np.zeros_like(clouds[k].position), np.full(len(clouds[k].scale), 3.0)
        motion = point_motion(clouds[k], clouds[other], seed=k)
        return motion.displacement / (times[other] - times[k]), motion.residual

    clouds, result = [], []
    report(0, 2 * len(times), "loads or compiles its programs")
    for cloud in mapped_in_threads(cloud_at, times, _threads()):
        clouds.append(cloud)
        report(len(clouds), 2 * len(times))
    for k, motion in enumerate(mapped_in_threads(motion_of, range(len(clouds)), _threads())):
        result.append(MovingPoints(clouds[k], float(times[k]), *motion))
        report(len(clouds) + k + 1, 2 * len(times))
    return result


def _threads() -> int:
    """How many times are looked at together: on a GPU, threads prepare others while it works on
    one."""
    return 1 if jax.default_backend() == "cpu" else 4


def _alone(
    footage: Footage,
    time: float,
    moved: MovingPixels,
    alone: Callable[[int], StereoPoints] | None,
) -> StereoPoints:
    """Points of the one picture of a timestamp that shows that something moves, if there is one."""
    if alone is None:
        return no_points()
    for frame in np.flatnonzero(footage.times == footage.times.dtype.type(time)):
        mask = moved(int(frame))
        if mask is not None and mask.any():
            return alone(int(frame))
    return no_points()


def _moving(views, moved, options, known=None, report=lambda done: None) -> StereoPoints:
    """Points of the pixels that move; a silhouette that misses a point counts against it. Where
    fewer of them match than a share of the pixels, points inside the silhouettes fill up."""
    wanted = reduced_mask(moved, options)
    matched = stereo_points(
        views.pictures,
        views.cameras,
        views.masks,
        options=with_silhouette(options),
        known=known,
        wanted=wanted,
        report=report,
    )
    masked = ~views.masks.all(axis=(1, 2))
    if len(matched.position) >= _ENOUGH * wanted.sum() / masked.sum():
        return matched
    own, factor = (
        jax.tree.map(lambda x: x[masked], views),
        reduction(moved.shape[1:], options.pixels),
    )
    seen = stereo_views(own.pictures, own.cameras, own.masks, factor=factor)
    inside = silhouette_points(seen, wanted[masked])
    return StereoPoints(*(np.concatenate(x) for x in zip(matched, inside, strict=True)))
