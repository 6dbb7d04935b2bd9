"""Where the pictures change: which tiles deserve more rays, which points belong to what moves."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from gaussray.camera.camera import project
from gaussray.capture.batches import Footage, tile_grid


# A channel of an encoded picture must change by this much to count (the benchmark's own threshold).
CHANGE = 0.1


def moved_pixels(footage: Footage, camera: np.ndarray) -> Bool[np.ndarray, "frames h w"]:
    """Which pixels differ by more than CHANGE from their own camera's temporal median; `camera`
    names the camera of each frame."""
    picture = _unit(footage)
    moved = np.zeros(picture.shape[:3], bool)
    for name in np.unique(camera):
        own = np.flatnonzero(camera == name)
        median = np.median(picture[own], axis=0)
        moved[own] = np.max(np.abs(picture[own] - median), axis=-1) > CHANGE
    return moved


def tile_activity(
    footage: Footage, moved: Bool[np.ndarray, "frames h w"], *, side: int
) -> Float[np.ndarray, "frames tiles"]:
    """Share of the pixels that have `moved` in every tile of every frame."""
    columns, rows = tile_grid(footage, side)
    height, width = moved.shape[1:]
    y = np.minimum(np.arange(rows) * side, height - side)[:, None]
    x = np.minimum(np.arange(columns) * side, width - side)[None, :]
    total = np.pad(moved.cumsum(1).cumsum(2), ((0, 0), (1, 0), (1, 0)))
    box = total[:, y + side, x + side] - total[:, y, x + side]
    box = box - total[:, y + side, x] + total[:, y, x]
    return (box / side**2).astype(np.float32).reshape(len(moved), -1)


def point_activity(
    footage: Footage, camera: np.ndarray, position: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, " points"]:
    """How much of the time the pictures show something else where each point was at first.

    Per camera: the share of frames in which the point's pixel differs by more than CHANGE from the
    camera's first frame; then the median over the cameras whose picture holds the point. Near 1 for
    points on a body that leaves; near 0 for what stands still, even if bodies pass in front of it
    in some views. Points that no camera sees count as still.
    """
    picture = _unit(footage)
    height, width = picture.shape[1:3]
    times = footage.times
    shares = []
    for name in np.unique(camera):
        own = np.flatnonzero(camera == name)
        first = own[np.argmin(times[own])]
        change = np.max(np.abs(picture[own] - picture[first]), axis=-1) > CHANGE
        share = change.mean(axis=0)
        one = jax.tree.map(lambda x, f=first: x[f], footage.camera)
        pixel = np.asarray(jax.vmap(project, in_axes=(None, 0))(one, jnp.asarray(position)))
        with np.errstate(invalid="ignore"):
            inside = np.all((pixel >= 0) & (pixel < (width, height)), axis=1)
        x, y = np.where(inside[:, None], pixel, 0).astype(int).T
        shares.append(np.where(inside, share[y, x], np.nan))
    table = np.array(shares)
    seen = ~np.all(np.isnan(table), axis=0)
    result = np.zeros(len(position))
    result[seen] = np.nanmedian(table[:, seen], axis=0)
    return result


def _unit(footage: Footage) -> np.ndarray:
    picture = np.asarray(footage.picture)
    return picture.astype(np.float32) / 255 if picture.dtype == np.uint8 else picture
