"""Where the pictures change: which tiles deserve more rays, which points belong to what moves."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, UInt16

from gaussray.camera.camera import project
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import join, tile_of, tile_pixels


# A channel of an encoded picture must change by this much to count (the benchmark's own threshold).
CHANGE = 0.1
# Pictures of a camera, evenly spread in time, of which the median is taken at most.
_SAMPLE = 63
# Bytes of pictures that are looked at together.
PIECE = 1 << 24


class Activity(NamedTuple):
    """What the pictures of each camera look like most of the time, tile by tile (temporal median,
    NaN where nothing is ever visible), and how many pixels of each tile differ from it by more than
    CHANGE in each frame."""

    background: Float[np.ndarray, "cameras tiles pixels 3"]
    moved: UInt16[np.ndarray, "frames tiles"]


def activity(footage: Footage) -> Activity:
    """Look through all pictures, camera by camera, a few of their tiles at a time."""
    names, pixel = np.unique(footage.viewpoints), footage.pixel
    # Halves of codes, as medians are, have an exact half-precision float.
    kind = np.float16 if pixel.dtype == np.uint8 else np.float32
    background = np.empty((len(names), *pixel.shape[1:]), kind)
    moved = np.empty(pixel.shape[:2], np.uint16)
    for row, name in enumerate(names):
        own = np.flatnonzero(footage.viewpoints == name)
        some = np.linspace(0, len(own) - 1, min(len(own), _SAMPLE)).round().astype(int)
        step = max(1, PIECE // (len(own) * pixel[0, 0].nbytes))
        for part in (slice(i, i + step) for i in range(0, pixel.shape[1], step)):
            seen, visible = pixel[own, part], footage.visible(own, part)
            median = _median(seen[some], None if visible is None else visible[some])
            background[row, part] = median
            away = _differs(seen, median, footage.scale)
            moved[own, part] = np.sum(away if visible is None else away & visible, axis=-1)
    return Activity(background, moved)


def moved_pixels(footage: Footage, activity: Activity, frames) -> Bool[np.ndarray, "n h w"]:
    """Which pixels of these frames differ from what they show most of the time."""
    names = np.unique(footage.viewpoints)
    pixels = tile_pixels(footage.film, footage.side, footage.bundle)
    rows = np.searchsorted(names, footage.viewpoints[frames])
    return np.stack(
        [
            join(
                _differs(footage.pixel[frame], activity.background[row], footage.scale),
                pixels,
                footage.film,
            )
            for frame, row in zip(frames, rows, strict=True)
        ]
    )


def point_activity(
    footage: Footage, position: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, " points"]:
    """How much of the time the pictures show something else where each point was at first.

    Per camera: the share of frames in which the point's pixel differs by more than CHANGE from the
    camera's first frame, of those in which both are visible; then the median over the cameras whose
    picture holds the point. Near 1 for points on a body that leaves; near 0 for what stands still,
    even if bodies pass in front of it in some views. Points that no camera sees count as still.
    """
    film, times = footage.film, footage.times
    shares = []
    for name in np.unique(footage.viewpoints):
        own = np.flatnonzero(footage.viewpoints == name)
        first = own[np.argmin(times[own])]
        camera = jax.tree.map(lambda x, f=first: x[f], footage.camera)
        pixel = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, jnp.asarray(position)))
        with np.errstate(invalid="ignore"):
            inside = np.all((pixel >= 0) & (pixel < (film.width, film.height)), axis=1)
        column, row = pixel[inside].astype(int).T
        tile, place = tile_of(film, footage.side, column, row, footage.bundle)
        before = footage.pixel[first, tile, place]
        changed, told = np.zeros(len(tile)), np.zeros(len(tile))
        for frame in own:
            both = _visible(footage, frame, tile, place) & _visible(footage, first, tile, place)
            told += both
            now = footage.pixel[frame, tile, place]
            changed += both & _differs(now, before, footage.scale)
        share = np.full(len(position), np.nan)
        share[inside] = np.divide(changed, told, out=np.full(len(tile), np.nan), where=told > 0)
        shares.append(share)
    table = np.array(shares)
    seen = ~np.all(np.isnan(table), axis=0)
    result = np.zeros(len(position))
    result[seen] = np.nanmedian(table[:, seen], axis=0)
    return result


def _visible(footage, frame, tile, place):
    if footage.mask is None:
        return True
    return footage.mask[frame, tile, place // 8] >> (7 - place % 8) & 1 > 0


def _differs(seen, other, scale):
    """Whether any channel differs by more than CHANGE."""
    difference = np.abs(seen.astype(np.float32) - other.astype(np.float32))
    return np.any(difference > CHANGE * scale, axis=-1)


def _median(seen, visible):
    """Median over the first axis of what is visible; NaN where nothing is."""
    if visible is None:
        return np.median(seen, axis=0).astype(np.float32)
    known = np.where(visible[..., None], seen.astype(np.float32), np.nan)
    known, count = np.sort(known, axis=0), visible.sum(axis=0)[None, ..., None]
    middle = [np.maximum(k, 0) for k in ((count - 1) // 2, count // 2)]
    low, high = (np.take_along_axis(known, k, axis=0)[0] for k in middle)
    return (low + high) / 2
