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
# Halvings of the interval in which a median of colour differences lies.
_HALVINGS = 20
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
    if not count or len(views.origin) < 2:
        return np.zeros(count, bool)
    rows = -(-total // _ROWS) * _ROWS
    place, shade = (np.full((rows, 3), np.nan, np.float32) for _ in range(2))
    place[:total] = np.concatenate([position, fixed])
    shade[:count] = color
    removed = np.asarray(_removed(views, jnp.asarray(place), jnp.asarray(shade)))[:count]
    return removed if removed.sum() <= _MOST * count else np.zeros(count, bool)


class _Look(NamedTuple):
    """How a picture sees the points: the cell in which each lies, the one after the last for those
    that it does not see, their distances, and whether it shows another colour there."""

    cell: Int[Array, " n"]
    away: Float[Array, " n"]
    differs: Bool[Array, " n"]


@kept_jit
def _removed(
    views: StereoViews, place: Float[Array, "n 3"], shade: Float[Array, "n 3"]
) -> Bool[Array, " n"]:
    """Which points are removed in all rounds. Without a colour (NaN) they only hide others."""
    looks = jax.lax.map(lambda i: _look(views, i, place, shade), jnp.arange(len(views.origin)))
    judged = jnp.isfinite(shade[:, 0])

    def again(state):
        turn, _, last = state
        return (turn < _ROUNDS) & (last >= 1e-3 * jnp.sum(judged))

    def removing(state):
        turn, keep, _ = state

        def counted(sums, look):
            visible = _visible(look, keep, _most_cells(views))
            confirmed, against = sums
            return (confirmed + (visible & ~look.differs), against + (visible & look.differs)), None

        none = jnp.zeros(len(place), jnp.int32)
        (confirmed, against), _ = jax.lax.scan(counted, (none, none), looks)
        gone = judged & keep & (against > _SHARE * confirmed + _ONE_MORE)
        return turn + 1, keep & ~gone, jnp.sum(gone)

    start = 0, jnp.ones(len(place), bool), jnp.sum(judged)
    return ~jax.lax.while_loop(again, removing, start)[1]


def _most_cells(views):
    """Number of the finest cells of a picture."""
    h, w = views.size
    return -(-h // _FINEST) * -(-w // _FINEST)


def _look(views, i, place, shade) -> _Look:
    """How the view of this number sees the points."""
    h, w = views.size
    column, row, away, inside, offset = _seen(views, i, place, shade)
    side = jnp.sqrt(_IN_CELL * h * w / jnp.maximum(jnp.sum(inside), 1))
    side = jnp.clip(jnp.round(side), _FINEST, _COARSEST).astype(jnp.int32)
    x, y = (jnp.floor(k / side).astype(jnp.int32) for k in (column, row))
    # The colour of most points differs by the picture's exposure.
    usual = _median(offset, inside & jnp.isfinite(offset[:, 0]))
    differs = _differs(views.pixel[i], column, row, shade, usual)
    return _Look(jnp.where(inside, y * -(-w // side) + x, _most_cells(views)), away, differs)


def _median(value, known):
    """The median of the known rows, of each column by halving where it lies between -1 and 1; 0 if
    none is known."""
    number = jnp.sum(known)

    def halve(_, bounds):
        low, high = bounds
        middle = (low + high) / 2
        below = jnp.sum(known[:, None] & (value <= middle[None]), axis=0)
        enough = 2 * below >= number
        return jnp.where(enough, low, middle), jnp.where(enough, middle, high)

    one = jnp.ones(value.shape[1], value.dtype)
    _, high = jax.lax.fori_loop(0, _HALVINGS, halve, (-one, one))
    return jnp.where(number > 0, high, 0)


def _visible(look, keep, cells):
    """Which points of a picture are kept and have no kept point in front of them."""
    here = keep & (look.cell < cells)
    nearest = jnp.full(cells + 1, jnp.inf, look.away.dtype)
    nearest = nearest.at[look.cell].min(jnp.where(here, look.away, jnp.inf))
    return here & (look.away <= _BEHIND * nearest[look.cell])


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
