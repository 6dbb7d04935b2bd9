"""Cameras that stand still: their temporal medians, and what moves in their pictures."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.ndimage import uniform_filter

from gaussray.capture.spread import spread_indices
from gaussray.capture.temporal_median import differs, temporal_median
from gaussray.reconstruct.data.pictures import Footage
from gaussray.runtime.side_by_side import mapped_in_threads, threads_within


# Frames of one camera of which the temporal median is taken, at least and at most.
FEWEST_FRAMES, _MOST = 3, 31
# Of a pixel's 3 x 3 neighbourhood, the share that must move with it.
_CLEAN = 0.4


class MedianMasks:
    """Which pixels of a frame of a camera that stands still differ from the camera's temporal
    median; isolated ones are noise. None for frames of other cameras, and of those of too few
    frames."""

    def __init__(self, footage: Footage):
        self._footage = footage
        self._frames = {
            int(frame): own
            for own, still in camera_frames(footage)
            if still and len(own) >= FEWEST_FRAMES
            for frame in own
        }

    def __call__(self, frame: int) -> Bool[np.ndarray, "h w"] | None:
        own = self._frames.get(frame)
        if own is None:
            return None
        median, known = median_picture(self._footage, own)
        picture = self._footage.pictures(np.array([frame]))[0]
        return without_specks(differs(picture, median, self._footage.scale) & known)


def without_specks(moved: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Moving pixels without isolated ones."""
    return moved & (uniform_filter(moved.astype(np.float32), 3) > _CLEAN)


def one_at_a_time(times: Float[np.ndarray, " frames"]) -> bool:
    """Whether most times have a single picture.

    Args:
        times: the time of each picture.
    """
    _, pictures = np.unique(times, return_counts=True)
    return float(np.median(pictures)) == 1


def still_camera_count(footage: Footage) -> int:
    """How many cameras stand still in so many pictures that a temporal median means something."""
    return sum(still and len(own) >= FEWEST_FRAMES for own, still in camera_frames(footage))


def camera_frames(footage: Footage) -> list[tuple[Int[np.ndarray, " frames"], bool]]:
    """The frames of every camera in the order of time, and whether it stands still in all of them:
    what a camera is named says nothing of that."""
    path = footage.camera.trajectory
    pose = np.concatenate([np.asarray(path.quat), np.asarray(path.translation)], axis=-1)
    result = []
    for name in np.unique(footage.name):
        own = np.flatnonzero(footage.name == name)
        own = own[np.argsort(footage.times[own], kind="stable")]
        still = path.shake is None and np.ptp(pose[own], axis=(0, 1)).max() < 1e-6
        several = len(np.unique(footage.times[own])) == len(own)
        result.append((own, bool(still and several)))
    return result


def find_medians(footage: Footage, cameras: Sequence[Int[np.ndarray, " frames"]]) -> None:
    """Find the temporal medians of several cameras at the same time: the footage keeps them.

    Args:
        footage: the training pictures.
        cameras: the frames of each camera.
    """
    most = max(map(len, cameras), default=0)
    threads = threads_within(min(most, _MOST) * footage.pixel[0].nbytes)
    list(mapped_in_threads(lambda own: median_picture(footage, own), cameras, threads))


def median_picture(
    footage: Footage, own: Int[np.ndarray, " frames"]
) -> tuple[Shaped[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Temporal median of a camera's pictures, and where at least half of them count. The footage
    keeps them.

    Args:
        footage: the training pictures.
        own: the frames of the camera; of more than _MOST, so many, evenly spread, are used.

    Returns:
        The median in the values of `Footage.pixel`, 0 where it is not known, and where it is known.
    """
    kept, camera = footage.medians, int(own[0])
    if camera in kept:
        return kept[camera]
    chosen = own[spread_indices(len(own), _MOST)]
    pictures, masks = footage.pictures(chosen), footage.masks(chosen)
    median = temporal_median(pictures, masks)
    known = np.ones(median.shape[:2], bool) if masks is None else masks.mean(axis=0) >= 0.5
    kept[camera] = np.where(known[..., None], median, 0).astype(pictures.dtype), known
    return kept[camera]
