"""Points for what no point stands on: plain walls, ceilings, what a single camera sees.

Where matching fails, each picture still tells colours. A ray without a point gets one, about where
other pictures show its colour too (`agreement`), and where that does not tell, as far away as the
nearest points beside it in the picture; training moves it where it belongs. Without, a fit has
nothing there to begin with, and density control only adds where something is.

Before a plain backdrop (a studio's, or what transparent pixels are composited over) that would fill
the air around things with Gaussians that hide them from other sides. Rays that see it get none.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from gaussray.capture.points import Points
from gaussray.color import srgb_decode
from gaussray.reconstruct.data.backdrop import BackdropColor, like_backdrop
from gaussray.reconstruct.initialize.stereo.agreement import agreeing_distance
from gaussray.reconstruct.initialize.stereo.carving import contradicted
from gaussray.reconstruct.initialize.stereo.neighbours import typical_spread
from gaussray.reconstruct.initialize.stereo.view_sets import StereoViewSet, small_views, some_views
from gaussray.reconstruct.initialize.stereo.views import (
    StereoViews,
    places_in_view,
    rays,
    stereo_views,
    unpacked,
)
from gaussray.runtime.progress import ProgressReport, no_report
from gaussray.runtime.stored_programs import kept_jit


# Sides of cells of which each is to hold a point, in pixels of `small_views`.
_FINEST, _COARSEST = 4, 16
# Pictures that are looked at, at most.
VIEWS = 120
# By how much distances differ from that of the nearest points, as a logarithm.
_JITTER = 0.2
# Standard deviations up to which a ball hides what is behind it, and within which no camera stands.
_REACH, _CLEAR = 2.0, 3.0


def uncovered_points(
    seen: StereoViewSet,
    position: Float[np.ndarray, "points 3"],
    *,
    count: int,
    seed: int,
    plain: BackdropColor | None = None,
    report: ProgressReport = no_report,
) -> Points:
    """A point for every cell of a picture in which none of the points lies, unless other pictures
    contradict it (`carving.contradicted`).

    Args:
        seen: pictures that show what stands still.
        position: the points that there are, in the world.
        count: about how many cells all pictures have together; cells are at least 4 and at most 16
            pixels of a reduced picture wide.
        seed: of the choice of pixels and distances.
        plain: the colour of a backdrop, which gets no points; None if there is none.
        report: called with the number of pictures looked at, and of all.
    """
    seen = some_views(seen, VIEWS)
    views, side = _with_cells(seen, count)
    large = stereo_views(seen.pictures, seen.cameras, seen.masks, factor=views.factor * side)
    cells = large.size
    most = len(seen.frames) * cells[0] * cells[1]
    # Rows for all points that may be added: one program does for all views.
    every = np.full((len(position) + most, 3), np.nan, np.float32)
    every[: len(position)] = position
    colors, filled, usual = [], len(position), typical_spread(views)
    for i in range(len(seen.frames)):
        report(i, len(seen.frames))
        dice = np.random.default_rng([seed, i, 4])
        index = jnp.asarray(i)
        nearest, (ray, color, visible) = jax.device_get(
            (_nearest(views, index, jnp.asarray(every), side), _shown(views, index))
        )
        empty = ~np.isfinite(nearest)
        if not empty.any():
            continue
        beside = np.full(cells, usual) if empty.all() else _with_gaps_filled(nearest)
        distance = agreeing_distance(large, i, beside, dice)
        y, x = np.nonzero(empty)
        y, x = (side * k + dice.integers(side, size=len(k)) for k in (y, x))
        shade, mask = color[y, x], visible[y, x]
        direction = ray[:, y, x].T
        shown = mask & np.any(direction != 0, axis=1)
        along = distance[empty] * np.exp(dice.uniform(-_JITTER, _JITTER, len(y)))
        if plain is not None:
            shown &= ~like_backdrop(shade, plain)
        place = np.asarray(views.origin[i]) + direction * along[:, None]
        number = int(shown.sum())
        every[filled : filled + number] = place[shown]
        colors.append(shade[shown])
        filled += number
    report(len(seen.frames), len(seen.frames))
    color = np.concatenate([np.zeros((0, 3)), *colors])
    found = every[len(position) : filled]
    right = ~contradicted(views, found, color.astype(np.float32), fixed=position)
    light = srgb_decode(color[right].astype(np.float64))
    return Points(found[right], light.astype(np.float32))


def coverage(
    seen: StereoViewSet,
    position: Float[np.ndarray, "points 3"],
    *,
    count: int,
    plain: BackdropColor | None = None,
) -> float:
    """In which share of the pictures' cells any of the points lies.

    Cells that are masked, or show a plain backdrop, for the most part do not count; without any
    others all is covered.

    Args:
        seen: the pictures.
        position: the points, in the world.
        count: about how many cells all pictures have together (`uncovered_points`).
        plain: the colour of a backdrop; None if there is none.
    """
    seen = some_views(seen, VIEWS)
    views, side = _with_cells(seen, count)
    cells = views.size[0] // side, views.size[1] // side
    held = total = 0
    for i in range(len(seen.frames)):
        index = jnp.asarray(i)
        nearest, (ray, color, mask) = jax.device_get(
            (_nearest(views, index, jnp.asarray(position), side), _shown(views, index))
        )
        shown = mask & np.any(ray != 0, axis=0)
        if plain is not None:
            shown &= ~like_backdrop(color, plain)
        whole = shown[: cells[0] * side, : cells[1] * side]
        counts = whole.reshape(cells[0], side, cells[1], side).mean(axis=(1, 3)) >= 0.5
        held += int((counts & np.isfinite(nearest)).sum())
        total += int(counts.sum())
    return held / total if total else 1.0


def hiding(
    seen: StereoViewSet,
    position: Float[np.ndarray, "points 3"],
    more: Float[np.ndarray, "more 3"],
    size: Float[np.ndarray, " more"],
    *,
    count: int,
) -> Bool[np.ndarray, " more"]:
    """Which balls lie in front of the points that some picture shows, or around its camera.

    A ball hides what is behind it if its middle, or a place two standard deviations from it, is
    nearer to the camera than the nearest point in its cell or, where that is empty, in the nearest
    cell that is not. It is around a camera within three standard deviations.

    Args:
        seen: the pictures.
        position: the points that they show, in the world.
        more: centres of the balls in the world.
        size: standard deviation of each ball, in scene units.
        count: about how many cells all pictures have together (`uncovered_points`).
    """
    seen = some_views(seen, VIEWS)
    views, side = _with_cells(seen, count)
    cells = views.size[0] // side, views.size[1] // side
    steps = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    around = (more[:, None] + _REACH * size[:, None, None] * steps).reshape(-1, 3)
    known, balls = (jnp.asarray(x, jnp.float32) for x in (position, around))
    hides = np.zeros(len(more), bool)
    for i in range(len(seen.frames)):
        hides |= np.linalg.norm(more - np.asarray(views.origin[i]), axis=1) < _CLEAR * size
        nearest = np.asarray(_nearest(views, jnp.asarray(i), known, side))
        if not np.isfinite(nearest).any():
            continue
        column, row, away, inside = jax.device_get(places_in_view(views, jnp.asarray(i), balls))
        y, x = (
            np.clip(np.where(inside, place, 0).astype(int) // side, 0, number - 1)
            for place, number in zip((row, column), cells, strict=True)
        )
        before = inside & (away < _with_gaps_filled(nearest)[y, x])
        hides |= before.reshape(len(more), -1).any(axis=1)
    return hides


def _with_cells(seen: StereoViewSet, count: int) -> tuple[StereoViews, int]:
    """Reduced pictures, and the side of cells of which all pictures have `count`, about."""
    views = small_views(seen)
    h, w = views.size
    side = np.sqrt(len(seen.frames) * h * w / max(count, 1))
    return views, min(int(np.clip(round(side), _FINEST, _COARSEST)), h, w)


@kept_jit
def _nearest(
    views: StereoViews, i: Int[Array, ""], position: Float[Array, "points 3"], side: int
) -> Float[Array, "rows columns"]:
    """Distance of the nearest point in each cell of a view, infinite in those without any."""
    column, row, away, inside = places_in_view(views, i, position)
    cells = [size // side for size in views.size]
    x, y = (jnp.floor(place / side).astype(jnp.int32) for place in (column, row))
    nearest = jnp.full(cells, jnp.inf, away.dtype)
    return nearest.at[y, x].min(jnp.where(inside, away, jnp.inf), mode="drop")


def _with_gaps_filled(
    nearest: Float[np.ndarray, "rows columns"],
) -> Float[np.ndarray, "rows columns"]:
    """The distances of `_nearest`, in empty cells that of the nearest cell that is not."""
    empty = ~np.isfinite(nearest)
    beside = np.asarray(distance_transform_edt(empty, return_distances=False, return_indices=True))
    return nearest[beside[0], beside[1]]


@kept_jit
def _shown(views: StereoViews, i: Int[Array, ""]) -> tuple[Array, Array, Array]:
    """Rays and colours of the pixels of a view, and which of them count."""
    own = views[i]
    ray = rays(own.lens, own.world_from_camera, own.size, own.factor)
    channels, visible = unpacked(own.pixel, ray.dtype)
    return ray, jnp.stack(channels, axis=-1), visible
