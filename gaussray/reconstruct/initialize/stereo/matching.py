"""Dense multi-view stereo: points of all surfaces that the pictures of one instant show."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from gaussray.camera.camera import Camera
from gaussray.reconstruct.initialize.stereo.consistency import Agreement, agreement
from gaussray.reconstruct.initialize.stereo.neighbours import StereoPairs, stereo_pairs
from gaussray.reconstruct.initialize.stereo.options import StereoOptions
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
    share of the points that other views confirm.

    Args:
        pictures: sRGB-encoded, bytes or floats in 0..1.
        cameras: theirs, stacked; any lens.
        masks: where each picture counts; None is everywhere.
        options: how carefully to look (`options_for` chooses by device).
        known: points of the scene, as a structure from motion finds them: they narrow down the
            distances that are looked at.
        wanted: of which pixels of the reduced pictures there shall be points; None is of all.
        report: called with the number of views done, of twice as many as pictures.

    Raises:
        ValueError: fewer than two views.
    """
    if len(pictures) < 2:
        raise ValueError(f"stereo needs at least 2 views, got {len(pictures)}.")
    factor = reduction(pictures.shape[1:3], options.pixels)
    views = stereo_views(pictures, cameras, masks, factor=factor)
    pairs = stereo_pairs(views, options.neighbours, known)
    surfaces = []
    for i in range(len(pictures)):
        surfaces.append(matched(views, i, pairs, options))
        report(i + 1)
    parts = []
    for i in range(len(pictures)):
        of = None if wanted is None else wanted[i]
        parts.append(confirmed(views, i, pairs, surfaces, options, of))
        report(len(pictures) + i + 1)
    return evenly(StereoPoints(*map(np.concatenate, zip(*parts, strict=True))), options.points)


def reduction(size: tuple[int, int], pixels: int) -> int:
    """The integer by which a picture of this size is reduced to have about `pixels` at most."""
    return max(1, int(np.ceil(np.sqrt(size[0] * size[1] / pixels) - 0.05)))


def matched(views: StereoViews, i: int, pairs: StereoPairs, options: StereoOptions) -> Surface:
    """The surface that view `i` shows."""
    dtype, first = views.origin.dtype, pairs.farthest[i]
    span = max(pairs.nearest[i] - first, 0.0)
    count = int(np.clip(np.ceil(span / (_STRIDE * pairs.step[i])), 8, options.depths))
    step = jnp.asarray(span / (count - 1), dtype)
    levels = DepthLevels(jnp.asarray(first, dtype), step, jnp.asarray(count))
    neighbour = jnp.asarray(pairs.neighbour[i])
    return _matched(views, jnp.asarray(i), neighbour, levels, options)


@eqx.filter_jit
def _matched(
    views: StereoViews,
    i: Int[Array, ""],
    neighbour: Int[Array, " neighbours"],
    levels: DepthLevels,
    options: StereoOptions,
) -> Surface:
    own, near = views[i], views[neighbour]
    ray = rays(own.lens, own.world_from_camera, own.size, own.factor)
    small = halved(own)
    small_ray = rays(small.lens, small.world_from_camera, small.size, small.factor)
    swept = sweep_planes(small, small_ray, halved(near), levels, options)
    candidates = jax.tree.map(lambda x: _doubled(x, own.size), swept)
    return refine(own, ray, near, candidates, levels, options)


def _doubled(value: Float[Array, "... rows columns"], size: tuple[int, int]):
    """An array of twice the size, every value four times; the last repeats up to `size`."""
    value = jnp.repeat(jnp.repeat(value, 2, axis=-2), 2, axis=-1)
    lack = [n - m for n, m in zip(size, value.shape[-2:], strict=True)]
    return jnp.pad(value, [(0, 0)] * (value.ndim - 2) + [(0, k) for k in lack], mode="edge")


def confirmed(
    views: StereoViews,
    i: int,
    pairs: StereoPairs,
    surfaces: list[Surface],
    options: StereoOptions,
    wanted: Bool[np.ndarray, "rows columns"] | None = None,
) -> StereoPoints:
    """Those points of view `i` that other views confirm, of the wanted pixels."""
    chosen = pairs.neighbour[i]
    maps = jnp.stack([_trusted(surfaces[j], options.cost) for j in chosen])
    step = jnp.asarray(pairs.step[i], views.origin.dtype)
    result = _checked(views, jnp.asarray(i), jnp.asarray(chosen), surfaces[i], maps, step, options)
    own, agreed, position, color = jax.device_get(result)
    _, mask = jax.device_get(unpacked(views.pixel[i], views.origin.dtype))
    need = min(options.confirm, len(chosen))
    keep = (own.inverse > 0) & (agreed.confirmed >= need) & mask
    keep &= agreed.crossed <= agreed.confirmed
    if wanted is not None:
        keep &= wanted
    distance = 1 / agreed.inverse[keep]
    count = agreed.confirmed[keep]
    error = 0.5 * distance**2 * pairs.step[i] / np.sqrt(count + 1)
    sure = (1 - own.cost[keep]) * count / len(chosen)
    scale = distance * float(views.angle[i])
    return StereoPoints(
        position[:, keep].T, own.normal[:, keep].T, color[:, keep].T, sure, error, scale
    )


def _trusted(surface: Surface, cost: float) -> Float[Array, "h w"]:
    """A surface's inverse distances, 0 where it costs too much."""
    return jnp.where(surface.cost < cost, surface.inverse, 0)


@eqx.filter_jit
def _checked(
    views: StereoViews,
    i: Int[Array, ""],
    chosen: Int[Array, " near"],
    surface: Surface,
    maps: Float[Array, "near h w"],
    step: Float[Array, ""],
    options: StereoOptions,
) -> tuple[Surface, Agreement, Float[Array, "3 h w"], Float[Array, "3 h w"]]:
    """The trusted surface of a view, what others say of it, the places they agree on, and the
    colours."""
    own = views[i]
    ray = rays(own.lens, own.world_from_camera, own.size, own.factor)
    inverse = _trusted(surface, options.cost)
    agreed = agreement(own, ray, inverse, views[chosen], maps, step)
    distance = 1 / jnp.where(agreed.inverse > 0, agreed.inverse, 1)
    color, _ = unpacked(own.pixel, ray.dtype)
    position = own.origin[:, None, None] + ray * distance[None]
    return surface._replace(inverse=inverse), agreed, position, jnp.stack(color)
