"""Points that the pictures contradict: they hang in the air in front of what a picture shows.

Space carving (Kutulakos & Seitz 2000), of points instead of voxels. Where a surface has no texture,
points of a wrong distance match as well as the right ones. Other pictures look through them at
something of another colour. Such points are removed, the nearest ones first; what they have hidden
is judged after them. A start with them is a fog that a fit takes thousands of steps to clear.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaussray.reconstruct.initialize.stereo.views import (
    StereoViews,
    distance_from,
    seen_at,
    unpacked,
)
from gaussray.runtime.stored_programs import kept_jit


# Difference of a channel (of 1) from which on a picture contradicts a point, if no pixel beside the
# point's own differs less.
_DIFFERENT = 0.1
# A point stays while no more pictures contradict it than this share of those that confirm it, and
# one more.
_SHARE, _ONE_MORE = 0.5, 1
# The nearest point of a cell hides what is farther away by this factor. Points in a cell, about,
# and sides of cells in pixels.
_BEHIND, _IN_CELL, _FINEST, _COARSEST = 1.03, 8, 4, 16
# Rounds of removal. If more than this share of the points had to go, colours do not tell, and all
# stay.
_ROUNDS, _MOST = 6, 0.8
# Rows are padded to a multiple: one program does for several clouds.
_ROWS = 1 << 15


def contradicted(
    views: StereoViews,
    position: Float[np.ndarray, "points 3"],
    color: Float[np.ndarray, "points 3"],
    *,
    fixed: Float[np.ndarray, "fixed 3"] | None = None,
) -> Bool[np.ndarray, " points"]:
    """Which points too many pictures contradict: more than half as many as confirm them, and one.

    A picture that sees a point with nothing in front of it confirms it by showing its colour there,
    and contradicts it otherwise. Exposure and white balance may differ from picture to picture: the
    median difference of each picture does not count.

    Args:
        views: small pictures that show what stands still (`view_sets.small_views`).
        position: the points, in the world.
        color: theirs, sRGB-encoded, in 0..1.
        fixed: points that hide others and stay.
    """
    count, fixed = len(position), np.zeros((0, 3)) if fixed is None else fixed
    total = count + len(fixed)
    keep = np.ones(total, bool)
    if not count or len(views.origin) < 2:
        return ~keep[:count]
    rows = -(-total // _ROWS) * _ROWS
    place, shade = (np.full((rows, 3), np.nan, np.float32) for _ in range(2))
    place[:total] = np.concatenate([position, fixed])
    shade[:count] = color
    looks = _looks(views, jnp.asarray(place), jnp.asarray(shade), total)
    for _ in range(_ROUNDS):
        confirmed, against = (np.zeros(total, np.int32) for _ in range(2))
        for look in looks:
            visible = _visible(look, keep)
            confirmed[look.index[visible & ~look.differs]] += 1
            against[look.index[visible & look.differs]] += 1
        gone = keep & (against > _SHARE * confirmed + _ONE_MORE)
        gone[count:] = False
        keep &= ~gone
        if gone.sum() < 1e-3 * count:
            break
    removed = ~keep[:count]
    return removed if removed.sum() <= _MOST * count else np.zeros(count, bool)


class _Look(NamedTuple):
    """The points that lie within one picture: their numbers, cells and distances, whether the
    picture shows another colour there, and the number of cells."""

    index: Int[np.ndarray, " inside"]
    cell: Int[np.ndarray, " inside"]
    away: Float[np.ndarray, " inside"]
    differs: Bool[np.ndarray, " inside"]
    cells: int


def _looks(views: StereoViews, place: Array, shade: Array, total: int) -> list[_Look]:
    """How every picture sees the points."""
    h, w = views.size
    looks = []
    for i in range(len(views.origin)):
        number = jnp.asarray(i)
        x, y, *rest = _seen(views, number, place, shade)
        column, row, away, inside, offset = jax.device_get((x, y, *rest))
        side = np.sqrt(_IN_CELL * h * w / max(inside.sum(), 1))
        side = int(np.clip(round(side), _FINEST, _COARSEST))
        across = -(-w // side)
        # The colour of most points differs by the picture's exposure.
        known = inside & np.isfinite(offset[:, 0])
        usual = np.median(offset[known], axis=0) if known.any() else np.zeros(3, np.float32)
        differs = np.asarray(_differs(views.pixel[number], x, y, shade, jnp.asarray(usual)))
        index = np.flatnonzero(inside[:total])
        cell = (row[index] // side).astype(np.int32) * across + (column[index] // side).astype(int)
        looks.append(
            _Look(index, cell.astype(np.int32), away[index], differs[index], across * -(-h // side))
        )
    return looks


def _visible(look: _Look, keep: Bool[np.ndarray, " points"]) -> Bool[np.ndarray, " inside"]:
    """Which points of a picture are kept and have no kept point in front of them."""
    here = keep[look.index]
    nearest = np.full(look.cells, np.inf, look.away.dtype)
    np.minimum.at(nearest, look.cell[here], look.away[here])
    return here & (look.away <= _BEHIND * nearest[look.cell])


@kept_jit
def _seen(
    views: StereoViews, i: Int[Array, ""], place: Float[Array, "n 3"], shade: Float[Array, "n 3"]
) -> tuple[Array, Array, Array, Array, Array]:
    """Column, row and distance of the points in a view, whether it sees and counts them, and by how
    much its colours there differ from theirs."""
    alone = views[i[None]]
    column, row, inside = (x[0] for x in seen_at(alone, place.T))
    color, counts = _pixels_at(alone.pixel[0], column, row)
    away = distance_from(alone, place.T)[0]
    return column, row, away, inside & counts, color - shade


@kept_jit
def _differs(
    pixel: Int[Array, "h w"],
    column: Float[Array, " n"],
    row: Float[Array, " n"],
    shade: Float[Array, "n 3"],
    usual: Float[Array, "3"],
) -> Bool[Array, " n"]:
    """Whether a picture, but for its usual difference, shows other colours than those of the points
    at all nine pixels around them."""
    least = jnp.full(column.shape, jnp.inf, column.dtype)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            color, _ = _pixels_at(pixel, column + right, row + down)
            least = jnp.minimum(least, jnp.max(jnp.abs(color - (shade + usual[None])), axis=1))
    return least > _DIFFERENT


def _pixels_at(
    pixel: Int[Array, "h w"], column: Float[Array, " n"], row: Float[Array, " n"]
) -> tuple[Float[Array, "n 3"], Bool[Array, " n"]]:
    """Colours of the pixels in which places lie, and whether they count."""
    h, w = pixel.shape
    y, x = (jnp.clip(jnp.floor(k), 0, n - 1).astype(jnp.int32) for k, n in ((row, h), (column, w)))
    channels, counts = unpacked(pixel[y, x], column.dtype)
    return jnp.stack(channels, axis=-1), counts
