"""Motion masks of training pictures: tiles that get more rays, points of what moves."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt16

from gaussray.camera.camera import Camera, project
from gaussray.capture.spread import spread_indices
from gaussray.capture.temporal_median import MEDIAN_PIXELS, differs, temporal_median
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import join, tile_of
from gaussray.runtime.side_by_side import mapped_in_threads


# The largest number of pictures of a camera, evenly spread in time, that a median is computed of.
_SAMPLE = 63
# Bytes of pictures that are processed at once.
PIECE = 1 << 24


class Activity(NamedTuple):
    """What moves in the training pictures, tile by tile.

    Args:
        background: the temporal median of each camera; NaN where nothing is ever visible.
        moved: for each frame and tile, the number of pixels that differ from the background by more
            than `MOTION_THRESHOLD`.
    """

    background: Float[np.ndarray, "cameras tiles pixels 3"]
    moved: UInt16[np.ndarray, "frames tiles"]


def activity(footage: Footage) -> Activity:
    """The background of every camera and the moved pixels of every tile.

    Each thread works on a few tiles of one camera at a time, so that pictures on disk need little
    memory.
    """
    names, pixel = np.unique(footage.viewpoints), footage.pixel
    # A median of 8-bit levels is a multiple of 1/2, which half precision holds exactly.
    kind = np.float16 if pixel.dtype == np.uint8 else np.float32
    background = np.empty((len(names), *pixel.shape[1:]), kind)
    moved = np.empty(pixel.shape[:2], np.uint16)
    step = max(1, MEDIAN_PIXELS // pixel.shape[2])
    at_once = max(1, PIECE // (step * pixel[0, 0].nbytes))
    pieces = []
    for row, name in enumerate(names):
        frames = np.flatnonzero(footage.viewpoints == name)
        for first in range(0, pixel.shape[1], step):
            pieces.append((row, frames, slice(first, first + step)))

    def colors(frames, tiles):
        # Other threads go on while tiles are copied; not while NumPy looks up numbers.
        return np.stack([pixel[frame, tiles] for frame in frames])

    def find(piece):
        row, frames, tiles = piece
        sample = frames[spread_indices(len(frames), _SAMPLE)]
        median = temporal_median(colors(sample, tiles), footage.visible(sample, tiles))
        background[row, tiles] = median
        for some in (frames[i : i + at_once] for i in range(0, len(frames), at_once)):
            changed = differs(colors(some, tiles), median, footage.scale)
            visible = footage.visible(some, tiles)
            counted = changed if visible is None else changed & visible
            moved[some, tiles] = np.sum(counted, axis=-1)

    list(mapped_in_threads(find, pieces))
    return Activity(background, moved)


def moved_pixels(footage: Footage, activity: Activity, frames) -> Bool[np.ndarray, "n h w"]:
    """Which pixels of whole pictures differ from their camera's background.

    Args:
        footage: the training pictures.
        activity: their backgrounds (`activity`).
        frames: numbers of the frames.
    """
    moved = moved_in_tiles(footage, activity, frames)
    return np.stack([join(tiles, footage.places) for tiles in moved])


def moved_in_tiles(
    footage: Footage, activity: Activity, frames
) -> Bool[np.ndarray, "n tiles pixels"]:
    """Which pixels of the tiles of some frames differ from their camera's background.

    Args:
        footage: the training pictures.
        activity: their backgrounds (`activity`).
        frames: numbers of the frames.
    """
    rows = np.searchsorted(np.unique(footage.viewpoints), footage.viewpoints[frames])
    return np.stack(
        [
            differs(footage.pixel[frame], activity.background[row], footage.scale)
            for frame, row in zip(frames, rows, strict=True)
        ]
    )


def point_activity(
    footage: Footage, position: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, " points"]:
    """The share of the time in which the pixel of each point no longer shows the point.

    For each camera: the share of frames in which the point's pixel differs by more than
    `MOTION_THRESHOLD` from the camera's first frame, among the frames in which both are visible (of
    more than _SAMPLE frames, so many, evenly spread).
    The result is the median over the cameras whose picture holds the point; of a viewpoint of a
    single frame, such as those of a camera that moves, nothing is known. It is near 1 for points
    on a body that leaves, and near 0 for static points, even if bodies pass in front of them in
    some views. Points outside all pictures have 0.

    Args:
        footage: the training pictures and their cameras.
        position: the points in the world, where they are at the first time.
    """
    film, times = footage.film, footage.times
    own = [np.flatnonzero(footage.viewpoints == name) for name in np.unique(footage.viewpoints)]

    def share_in(frames: Int[np.ndarray, " frames"]) -> Float[np.ndarray, " points"]:
        first = frames[np.argmin(times[frames])]
        pixel = np.asarray(projected(footage.camera, jnp.asarray(first), jnp.asarray(position)))
        with np.errstate(invalid="ignore"):
            inside = np.all((pixel >= 0) & (pixel < (film.width, film.height)), axis=1)
        column, row = pixel[inside].astype(int).T
        tile, place = tile_of(film, footage.side, column, row, footage.bundle)
        before = footage.pixel[first, tile, place]
        changed, compared = np.zeros(len(tile)), np.zeros(len(tile))
        for frame in frames[spread_indices(len(frames), _SAMPLE)]:
            both = _visible(footage, frame, tile, place) & _visible(footage, first, tile, place)
            compared += both
            now = footage.pixel[frame, tile, place]
            changed += both & differs(now, before, footage.scale)
        share, unknown = np.full(len(position), np.nan), np.full(len(tile), np.nan)
        share[inside] = np.divide(changed, compared, out=unknown, where=compared > 0)
        return share

    shares = list(mapped_in_threads(share_in, [frames for frames in own if len(frames) > 1]))
    table = np.array(shares).reshape(-1, len(position))
    seen = ~np.all(np.isnan(table), axis=0)
    result = np.zeros(len(position))
    result[seen] = np.nanmedian(table[:, seen], axis=0)
    return result


@eqx.filter_jit
def projected(
    camera: Camera, frame: Int[Array, ""], position: Float[Array, "points 3"]
) -> Float[Array, "points 2"]:
    """Where the camera of a frame sees points, in pixels.

    Args:
        camera: the cameras of all frames, stacked.
        frame: number of the frame.
        position: points in the world.
    """
    own = jax.tree.map(lambda x: x[frame], camera)
    return jax.vmap(project, in_axes=(None, 0))(own, position)


def _visible(footage, frame, tile, place):
    if footage.mask is None:
        return True
    return footage.mask[frame, tile, place // 8] >> (7 - place % 8) & 1 > 0
