"""Dense multi-view stereo: points of all surfaces that the pictures of one instant show."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from gaussray.camera.camera import Camera
from gaussray.reconstruct.initialize.stereo.consistency import Agreement, agreement
from gaussray.reconstruct.initialize.stereo.neighbours import StereoPairs, stereo_pairs
from gaussray.reconstruct.initialize.stereo.options import StereoOptions
from gaussray.reconstruct.initialize.stereo.pixel_list import pixel_list
from gaussray.reconstruct.initialize.stereo.points import StereoPoints
from gaussray.reconstruct.initialize.stereo.refine import Surface, refine
from gaussray.reconstruct.initialize.stereo.subsample import evenly
from gaussray.reconstruct.initialize.stereo.sweep import DepthLevels, sweep_planes
from gaussray.reconstruct.initialize.stereo.views import (
    StereoViews,
    halved,
    rays,
    stereo_views,
    unpacked,
)
from gaussray.runtime.stored_programs import kept_jit


T = TypeVar("T")

# Share of the pixels that count above which pictures are refined whole, not in parts.
_MOST = 0.5
# Pixels beside those that count that are refined, too.
_BESIDE = 2
# Pixels of disparity between two levels of the sweep, which is of pictures of half the size.
_STRIDE = 2.5


def stereo_points(
    pictures: Shaped[np.ndarray, "views h w 3"],
    cameras: Camera,
    masks: Bool[np.ndarray, "views h w"] | None = None,
    *,
    options: StereoOptions,
    known: Float[np.ndarray, "known 3"] | None = None,
    wanted: Bool[np.ndarray, "views rows columns"] | None = None,
    report: Callable[[int], object] = lambda done: None,
) -> StereoPoints:
    """Points of all surfaces that pictures of one instant show from several sides.

    Plane sweep, refinement and cross-view check of every view against its neighbours; then an even
    share of the points that other views confirm. Only pixels that count, and those beside them, are
    refined.

    Args:
        pictures: sRGB-encoded, bytes or floats in 0..1.
        cameras: theirs, stacked; any lens.
        masks: where each picture counts; None is everywhere.
        options: how carefully to look (`options_for` chooses by device).
        known: points of the scene, as a structure from motion finds them: they narrow down the
            distances that are looked at.
        wanted: of which pixels of the reduced pictures there shall be points; None is of all.
        report: called with the number of steps done: one for each view that is matched, and one.

    Raises:
        ValueError: fewer than two views.
    """
    if len(pictures) < 2:
        raise ValueError(f"stereo needs at least 2 views, got {len(pictures)}.")
    factor = reduction(pictures.shape[1:3], options.pixels)
    views = stereo_views(pictures, cameras, masks, factor=factor)
    pairs = stereo_pairs(views, options.neighbours, known)
    count, surfaces, parts = len(pictures), [], []
    batches = _batches(views, pairs, options.at_once)
    samples = len(batches[0]) * pairs.neighbour.shape[1]
    part = _part_size(views.size, masks, options.part // samples)
    for rows in batches:
        surfaces.append(matched(views, rows, pairs, part, options))
        report(min(int(rows[-1]) + 1, count))
    surface = jax.tree.map(lambda *x: jnp.concatenate(x)[:count], *surfaces)
    for rows in batches:
        of = None if wanted is None else wanted[rows]
        parts += confirmed(views, rows, pairs, surface, options, of)
    report(count + 1)
    return evenly(
        StereoPoints(*map(np.concatenate, zip(*parts[:count], strict=True))), options.points
    )


def _batches(
    views: StereoViews, pairs: StereoPairs, at_once: int
) -> list[Int[np.ndarray, " rows"]]:
    """The rows of all views in batches of one size, so that one program does for all; the last
    batch repeats the last view."""
    count = len(views.origin)
    size = int(np.clip(at_once / (np.prod(views.size) * pairs.neighbour.shape[1]), 1, count))
    batches = -(-count // size)
    rows = np.minimum(np.arange(batches * -(-count // batches)), count - 1)
    return list(rows.reshape(batches, -1))


def _part_size(
    size: tuple[int, int], masks: Bool[np.ndarray, "views h w"] | None, pixels: int
) -> int:
    """Pixels of a view that are refined at once: so many, or all of a picture if most count."""
    most = masks is None or masks.mean() > _MOST
    return size[0] * size[1] if most else max(min(pixels, size[0] * size[1]), 1)


def reduction(size: tuple[int, int], pixels: int) -> int:
    """The integer by which a picture is reduced to have about `pixels` at most.

    Args:
        size: rows and columns of the picture.
        pixels: number of pixels that may be exceeded by a tenth.
    """
    return max(1, int(np.ceil(np.sqrt(size[0] * size[1] / pixels) - 0.05)))


def reduced_mask(
    mask: Bool[np.ndarray, "views h w"], options: StereoOptions
) -> Bool[np.ndarray, "views rows columns"]:
    """The masks of the reduced pictures that are matched: those of the pixels' middles.

    Args:
        mask: one of each picture.
        options: how many pixels pictures are reduced to.
    """
    factor = reduction(mask.shape[1:], options.pixels)
    h, w = (n // factor * factor for n in mask.shape[1:])
    middle = slice(factor // 2, None, factor)
    return mask[:, :h, :w][:, middle, middle]


def matched(
    views: StereoViews,
    rows: Int[np.ndarray, " rows"],
    pairs: StereoPairs,
    part: int,
    options: StereoOptions,
) -> Surface:
    """The surfaces that these views show, stacked; as the sweep finds them where no pixel counts.

    Args:
        views: all views.
        rows: indices of the views that are matched.
        pairs: neighbours and distances of all views.
        part: how many pixels of each view are refined at once.
        options: how carefully to look.
    """
    dtype, first = views.origin.dtype, pairs.farthest[rows]
    span = np.maximum(pairs.nearest[rows] - first, 0.0)
    count = np.ceil(span / (_STRIDE * pairs.step[rows])).clip(8, options.depths).astype(int)
    step = jnp.asarray(span / (count - 1), dtype)
    levels = DepthLevels(jnp.asarray(first, dtype), step, jnp.asarray(count))
    around = jnp.asarray(pairs.neighbour[rows])
    return _matched(views, jnp.asarray(rows), around, levels, part, options)


@kept_jit
def _matched(
    views: StereoViews,
    rows: Int[Array, " rows"],
    neighbour: Int[Array, "rows neighbours"],
    levels: DepthLevels,
    part: int,
    options: StereoOptions,
) -> Surface:
    _, counts = unpacked(views.pixel[rows], views.origin.dtype)
    # Others' points are compared with the four pixels around their places, and motion may not show
    # in one picture: what is beside the pixels that count is refined, too.
    window = (1, 2 * _BESIDE + 1, 2 * _BESIDE + 1)
    counts = jax.lax.reduce_window(
        counts, False, jax.lax.bitwise_or, window, (1, 1, 1), padding="SAME"
    )
    # All views of a batch go through as many parts: otherwise every one of them would copy the
    # surfaces of those that are done.
    most = jnp.max(levels.count)
    parts = -(-jnp.max(jnp.sum(counts, axis=(1, 2), dtype=jnp.int32)) // part)

    def one(row):
        i, around, levels, counts = row
        own, near = views[i], views[around]
        ray = rays(own.lens, own.world_from_camera, own.size, own.factor)
        small = halved(own)
        small_ray = rays(small.lens, small.world_from_camera, small.size, small.factor)
        swept = sweep_planes(small, small_ray, halved(near), levels, most, options)
        candidates = jax.tree.map(lambda x: _doubled(x, own.size), swept)
        pixels = pixel_list(counts, parts, part)
        return refine(own, ray, near, candidates, levels, pixels, options)

    return jax.lax.map(one, (rows, neighbour, levels, counts), batch_size=len(rows))


def _doubled(value: Float[Array, "... rows columns"], size: tuple[int, int]):
    """An array of twice the size, every value four times; the last repeats up to `size`."""
    value = jnp.repeat(jnp.repeat(value, 2, axis=-2), 2, axis=-1)
    lack = [n - m for n, m in zip(size, value.shape[-2:], strict=True)]
    return jnp.pad(value, [(0, 0)] * (value.ndim - 2) + [(0, k) for k in lack], mode="edge")


def confirmed(
    views: StereoViews,
    rows: Int[np.ndarray, " rows"],
    pairs: StereoPairs,
    surface: Surface,
    options: StereoOptions,
    wanted: Bool[np.ndarray, "rows h w"] | None,
) -> list[StereoPoints]:
    """For each of these views the points of its surface that other views confirm.

    Args:
        views: all views.
        rows: indices of the views whose points are returned.
        pairs: neighbours of all views.
        surface: surfaces of all views, stacked.
        options: how much a point may cost, and how many views must confirm it.
        wanted: which pixels of these views get points; None is all.
    """
    chosen = pairs.neighbour[rows]
    step = jnp.asarray(pairs.step[rows], views.origin.dtype)
    result = jax.device_get(
        _checked(views, jnp.asarray(rows), jnp.asarray(chosen), surface, step, options)
    )
    need, found = min(options.confirm, chosen.shape[1]), []
    for k, row in enumerate(rows):
        own, agreed, position, color, mask = (_row(part, k) for part in result)
        keep = (own.inverse > 0) & (agreed.confirmed >= need) & mask
        keep &= agreed.crossed <= agreed.confirmed
        if wanted is not None:
            keep &= wanted[k]
        distance = 1 / agreed.inverse[keep]
        count = agreed.confirmed[keep]
        error = 0.5 * distance**2 * pairs.step[row] / np.sqrt(count + 1)
        sure = (1 - own.cost[keep]) * count / chosen.shape[1]
        scale = distance * float(views.angle[row])
        place, normal = position[:, keep].T, own.normal[:, keep].T
        found.append(StereoPoints(place, normal, color[:, keep].T, sure, error, scale))
    return found


def _row(tree: T, k: int | Int[Array, ""]) -> T:
    """One row of all arrays of a tree."""
    return jax.tree.map(lambda x: x[k], tree)


@kept_jit
def _checked(
    views: StereoViews,
    rows: Int[Array, " rows"],
    chosen: Int[Array, "rows near"],
    surface: Surface,
    step: Float[Array, " rows"],
    options: StereoOptions,
) -> tuple[
    Surface,
    Agreement,
    Float[Array, "rows 3 h w"],
    Float[Array, "rows 3 h w"],
    Bool[Array, "rows h w"],
]:
    """The trusted surfaces of these views, what others say of them, the places they agree on,
    the colours and the masks."""
    trusted = surface._replace(inverse=jnp.where(surface.cost < options.cost, surface.inverse, 0))

    def one(parts):
        i, around, step = parts
        own = views[i]
        ray = rays(own.lens, own.world_from_camera, own.size, own.factor)
        mine = _row(trusted, i)
        agreed = agreement(own, ray, mine.inverse, views[around], trusted.inverse[around], step)
        distance = 1 / jnp.where(agreed.inverse > 0, agreed.inverse, 1)
        color, mask = unpacked(own.pixel, ray.dtype)
        position = own.origin[:, None, None] + ray * distance[None]
        return mine, agreed, position, jnp.stack(color), mask

    return jax.lax.map(one, (rows, chosen, step), batch_size=len(rows))
