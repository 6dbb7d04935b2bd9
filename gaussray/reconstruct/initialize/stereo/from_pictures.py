"""Points from the training pictures of a capture: of what stands still, and of what moves at given
timestamps with its velocities."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.ndimage import binary_dilation

from gaussray.camera.camera import Camera
from gaussray.capture.points import Points
from gaussray.reconstruct.data.backdrop import backdrop_of
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.still_cameras import (
    FEWEST_FRAMES,
    MedianMasks,
    camera_frames,
    median_picture,
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
from gaussray.reconstruct.initialize.stereo.views import StereoViews, stereo_views
from gaussray.runtime.progress import ProgressReport, no_report


# Residual of a registration from which on a velocity is not believed.
_BELIEVED = 2.0
# Points of what moves per moving pixel of a picture, below which silhouettes fill up.
_ENOUGH = 0.25
# Pixels that a picture in which points are looked at is reduced to, at most.
_SMALL = 33_000

T = TypeVar("T")
U = TypeVar("U")

# Which pixels of a frame move; None where that is not known.
MovingPixels = Callable[[int], Bool[np.ndarray, "h w"] | None]


class StereoViewSet(NamedTuple):
    """Pictures that show one instant, or what stands still, with their cameras.

    Args:
        pictures: sRGB-encoded, bytes or floats in 0..1.
        masks: which pixels count; None if all do.
        cameras: their cameras, stacked.
        frames: the frame of the footage that each picture is of (the first, for a median).
    """

    pictures: Shaped[np.ndarray, "views h w 3"]
    masks: Bool[np.ndarray, "views h w"] | None
    cameras: Camera
    frames: Int[np.ndarray, " views"]


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
        report: called with the number of steps done and their total: for what stands still, three
            for each picture.

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
    steps = 3 * pictures + 2 * (0 if first is None else len(first[0].frames))
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
        plain = backdrop_of(footage)
        wrong = contradicted(
            small_views(still),
            matched.position,
            matched.color,
            plain=plain,
            report=lambda done: report(2 * pictures + done, steps),
        )
        parts.append(StereoPoints(*(x[~wrong] for x in matched)))
    if first is not None:
        parts.append(
            _moving(
                *first,
                options,
                report=lambda done: report(3 * pictures + done, steps),
            )
        )
    found = StereoPoints(*(np.concatenate(x) for x in zip(no_points(), *parts, strict=True)))
    return Points(found.position.astype(np.float32), found.light.astype(np.float32))


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
    for cloud in _several_at_once(cloud_at, times):
        clouds.append(cloud)
        report(len(clouds), 2 * len(times))
    for k, motion in enumerate(_several_at_once(motion_of, range(len(clouds)))):
        result.append(MovingPoints(clouds[k], float(times[k]), *motion))
        report(len(clouds) + k + 1, 2 * len(times))
    return result


def _threads() -> int:
    """How many times are looked at together: on a GPU, threads prepare others while it works on
    one."""
    return 1 if jax.default_backend() == "cpu" else 4


def _several_at_once(find: Callable[[T], U], of: Sequence[T]) -> Iterator[U]:
    """What is found of each, in order; the first compiles for all."""
    yield from map(find, of[:1])
    threads = ThreadPoolExecutor(_threads(), "stereo")
    try:
        yield from threads.map(find, of[1:])
    finally:
        # Whoever interrupts does not wait for the rest.
        threads.shutdown(cancel_futures=True)


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


def still_views(footage: Footage) -> StereoViewSet:
    """One view per camera that stands still, its temporal median; of the others every frame."""
    pictures, masks, frames = [], [], []
    for own, still in camera_frames(footage):
        own = own if not still else own[: 1 if len(own) < FEWEST_FRAMES else None]
        if not still or len(own) == 1:
            pictures += list(footage.pictures(own))
            known = footage.masks(own)
            masks += [] if known is None else list(known)
            frames += own.tolist()
            continue
        median, known = median_picture(footage, own)
        pictures.append(median)
        masks.append(known)
        frames.append(int(own[0]))
    chosen = np.array(frames, np.int64)
    cameras = jax.tree.map(lambda x: x[chosen], footage.camera)
    seen = np.stack(masks) if len(masks) == len(pictures) else None
    return StereoViewSet(_stack(pictures, footage.scale), seen, cameras, chosen)


def first_views(footage: Footage, most: int) -> StereoViewSet:
    """The first picture of each camera that stands still, and all pictures of the others.

    Args:
        footage: the training pictures and their cameras.
        most: largest number of pictures; of more, an even share is taken.
    """
    own = [frames[:1] if still else frames for frames, still in camera_frames(footage)]
    chosen = np.sort(np.concatenate(own))
    if len(chosen) > most:
        chosen = chosen[np.linspace(0, len(chosen) - 1, most).round().astype(int)]
    cameras = jax.tree.map(lambda x: x[chosen], footage.camera)
    return StereoViewSet(footage.pictures(chosen), footage.masks(chosen), cameras, chosen)


def moving_views(
    footage: Footage, time: float, moved: MovingPixels
) -> tuple[StereoViewSet, Bool[np.ndarray, "views h w"]] | None:
    """The pictures of one timestamp, masked to what moves and a margin, and which pixels move; None
    unless one of them shows that something moves, and another one does or may.

    Args:
        footage: the training pictures and their cameras.
        time: the timestamp, in the capture's unit.
        moved: which pixels of a frame move; frames for which it gives None count everywhere, to
            match the others with, and none of their pixels moves.
    """
    chosen = np.flatnonzero(footage.times == footage.times.dtype.type(time))
    found = [moved(int(frame)) for frame in chosen]
    shows = sum(mask is not None and mask.any() for mask in found)
    if not shows or shows + sum(mask is None for mask in found) < 2:
        return None
    everywhere = np.ones((footage.film.height, footage.film.width), bool)
    masks = np.stack([~everywhere if mask is None else mask for mask in found])
    wide = np.stack(
        [everywhere if m is None else binary_dilation(m, np.ones((3, 3)), 3) for m in found]
    )
    cameras = jax.tree.map(lambda x: x[chosen], footage.camera)
    return StereoViewSet(footage.pictures(chosen), wide, cameras, chosen), masks


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
    told = ~views.masks.all(axis=(1, 2))
    if len(matched.position) >= _ENOUGH * wanted.sum() / told.sum():
        return matched
    own, factor = jax.tree.map(lambda x: x[told], views), reduction(moved.shape[1:], options.pixels)
    seen = stereo_views(own.pictures, own.cameras, own.masks, factor=factor)
    inside = silhouette_points(seen, wanted[told])
    return StereoPoints(*(np.concatenate(x) for x in zip(matched, inside, strict=True)))


def _stack(pictures, scale):
    return (
        np.stack(pictures) if pictures else np.zeros((0, 1, 1, 3), np.uint8 if scale > 1 else float)
    )


def small_views(seen: StereoViewSet) -> StereoViews:
    """The pictures, reduced to _SMALL pixels, in which points are looked at.

    Args:
        seen: pictures that show what stands still.
    """
    factor = reduction(seen.pictures.shape[1:3], _SMALL)
    return stereo_views(seen.pictures, seen.cameras, seen.masks, factor=factor)


def some_views(views: StereoViewSet, most: int) -> StereoViewSet:
    """The views, or an even share of them.

    Args:
        views: the pictures and their cameras.
        most: largest number of views.
    """
    if len(views.frames) <= most:
        return views
    chosen = np.linspace(0, len(views.frames) - 1, most).round().astype(int)
    return jax.tree.map(lambda x: x[chosen], views)
