"""The pictures that stereo matches: of one instant, or of what stands still."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Int, Shaped
from scipy.ndimage import binary_dilation

from gaussray.camera.camera import Camera
from gaussray.capture.spread import spread_indices
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.still_cameras import (
    FEWEST_FRAMES,
    camera_frames,
    find_medians,
    median_picture,
)
from gaussray.reconstruct.initialize.stereo.matching import reduction
from gaussray.reconstruct.initialize.stereo.views import StereoViews, stereo_views
from gaussray.runtime.side_by_side import mapped_in_threads, threads_within


# Pixels that a picture in which points are looked at is reduced to, at most.
_SMALL = 33_000

# Bytes that looking for what moves takes for each pixel of a picture.
_BYTES = 20

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


def still_views(footage: Footage) -> StereoViewSet:
    """One view per camera that stands still, its temporal median; of the others every frame."""
    pictures, masks, frames = [], [], []
    of_cameras = camera_frames(footage)
    find_medians(footage, [own for own, still in of_cameras if still and len(own) >= FEWEST_FRAMES])
    for own, still in of_cameras:
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
    chosen = chosen[spread_indices(len(chosen), most)]
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
    threads = threads_within(_BYTES * footage.film.width * footage.film.height)
    found = list(mapped_in_threads(lambda frame: moved(int(frame)), chosen, threads))
    shows = sum(mask is not None and mask.any() for mask in found)
    if not shows or shows + sum(mask is None for mask in found) < 2:
        return None
    everywhere = np.ones((footage.film.height, footage.film.width), bool)
    masks = np.stack([~everywhere if mask is None else mask for mask in found])

    def widened(mask: Bool[np.ndarray, "h w"] | None) -> Bool[np.ndarray, "h w"]:
        return everywhere if mask is None else binary_dilation(mask, np.ones((3, 3)), 3)

    wide = np.stack(list(mapped_in_threads(widened, found, threads)))
    cameras = jax.tree.map(lambda x: x[chosen], footage.camera)
    return StereoViewSet(footage.pictures(chosen), wide, cameras, chosen), masks


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
    chosen = spread_indices(len(views.frames), most)
    return jax.tree.map(lambda x: x[chosen], views)
