"""The plane sweep: every distance at once over whole pictures, on spheres and tilted planes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.reconstruct.initialize.stereo.cost import (
    best_half,
    comparison,
    misses,
    patch_cost,
    window,
)
from gaussray.reconstruct.initialize.stereo.options import StereoOptions
from gaussray.reconstruct.initialize.stereo.views import (
    StereoViews,
    sampled,
    seen_at,
    turned,
    unpacked,
)


# Levels around a family's chosen distance at which none of another family is taken.
_APART = 2
# The cosine between a ray and a plane's normal below which the ray is too grazing for its windows.
_GRAZING = 0.15


class DepthLevels(NamedTuple):
    """The inverse distances of a sweep: `count` of them from the `first`, a `step` apart."""

    first: Float[Array, ""]
    step: Float[Array, ""]
    count: Int[Array, ""]


class DepthCandidates(NamedTuple):
    """The best distances of every pixel of a view, with the normal and the cost of each."""

    inverse: Float[Array, "modes h w"]
    normal: Float[Array, "modes 3 h w"]
    cost: Float[Array, "modes h w"]


def sweep_planes(
    own: StereoViews,
    ray: Float[Array, "3 h w"],
    near: StereoViews,
    levels: DepthLevels,
    most: Int[Array, ""],
    options: StereoOptions,
) -> DepthCandidates:
    """Distances at which the windows of a view look most like its neighbours'.

    A level of the sphere has the same inverse distance along every ray; one of a tilted plane has
    it along the optical axis (Gallup et al. 2007: planes of several directions). A whole picture is
    warped at once, so that a window costs one sample. The local minima of every family of surfaces
    compete for the places.

    Args:
        own: the view whose surface is looked for.
        ray: unit viewing directions of its pixels in the world; zero where the lens has none.
        near: its neighbours.
        levels: the inverse distances that are tried.
        most: the largest count of levels of all views that are swept together: their loops end at
            once, and no view copies what it has found while others go on.
        options: tilts of the planes, size of the windows, the cost's weights, and how many `modes`
            of each pixel are returned.
    """
    reference, _ = unpacked(own.pixel, ray.dtype)
    means = _windowed(window(reference), options.radius)
    normals, shapes = _families(own, ray, options)

    def family(surface):
        normal, shape = surface

        def cost_at(level):
            inverse = (levels.first + level * levels.step) * shape
            cost = _level_cost(own, ray, near, reference, means, inverse, options)
            return jnp.where(shape > 0, cost, 2)

        level, cost = _minima(cost_at, levels.count, most, ray[0], options)
        inverse = (levels.first + level * levels.step) * shape[None]
        return DepthCandidates(inverse, jnp.broadcast_to(normal, (options.modes, *ray.shape)), cost)

    every = jax.lax.map(family, (normals, shapes))
    every = DepthCandidates(*(x.reshape(-1, *x.shape[2:]) for x in every))
    return every if len(normals) == 1 else _best(every, levels.step, options.modes)


def _minima(cost_at, count, most, like, options):
    """Levels [modes, h, w] of the lowest local minima over `count` levels, and their costs, the
    lowest first; 2 where there are fewer minima."""
    # From `like`: with views of a batch in it from the start, the loop is traced once.
    high = 0 * like + 2
    empty = jnp.stack([0 * like] * options.modes)

    def body(block, carry):
        block = block * options.levels + jnp.arange(options.levels)
        costs = jax.vmap(cost_at)(block.astype(like.dtype))
        for level, cost in zip(block, costs, strict=True):
            carry = with_level(level, jnp.where(level < count, cost, high), carry)
        return carry

    def with_level(level, cost, carry):
        before, last, kept, costs = carry
        lowest = (last < before) & (last <= cost)
        value = jnp.where(lowest, last, 2)
        place = jnp.full_like(like, 1) * (level - 1)
        # Insertion into the sorted list.
        rows = []
        for k in range(options.modes):
            better = value < costs[k]
            rows.append((jnp.where(better, place, kept[k]), jnp.where(better, value, costs[k])))
            place, value = (
                jnp.where(better, a, b) for a, b in ((kept[k], place), (costs[k], value))
            )
        kept, costs = (jnp.stack(x) for x in zip(*rows, strict=True))
        return last, cost, kept, costs

    start = high, high, empty, empty + 2
    # A minimum is known one level later.
    return jax.lax.fori_loop(0, most // options.levels + 1, body, start)[2:]


def _families(own, ray, options):
    """Normals [families, 3, h, w] and shapes of the surfaces that are swept: inverse distance along
    a ray over that along the axis; 0 where a ray does not meet the surface."""
    normals, shapes = [-ray], [jnp.ones_like(ray[0])]
    axis = own.world_from_camera
    for tilt in np.radians(options.tilts):
        for turn in np.arange(4) * (np.pi / 2):
            local = [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)]
            normal = turned(axis, jnp.asarray(local, ray.dtype)[:, None, None])
            facing = -jnp.sum(normal * ray, axis=0)
            shapes.append(jnp.where(facing > _GRAZING, facing, 0) / np.cos(tilt))
            normals.append(jnp.broadcast_to(normal, ray.shape))
    return jnp.stack(normals), jnp.stack(shapes)


def _level_cost(own, ray, near, reference, means, inverse, options):
    """Cost [h, w] of one surface of the sweep, given by the inverse distances along the rays, of
    the view's colours and their windows' means."""
    formed = jnp.any(ray != 0, axis=0) & (inverse > 0)
    point = own.origin[:, None, None] + ray / jnp.where(formed, inverse, 1)[None]

    x, y, inside = seen_at(near, point)
    color, hit = sampled(near.pixel, x, y)
    sees = inside & formed[None]
    if not options.silhouette:
        sees = sees & hit
    reference, means = jax.tree.map(lambda value: value[None], (reference, means))
    compared = _windowed(comparison(reference, color), options.radius)
    cost = best_half(patch_cost(means, compared, options), sees)
    return misses(cost, sees, hit, options.silhouette) if options.silhouette else cost


def _windowed(values, radius):
    return jax.tree.map(lambda value: windowed(value, radius), values)


def windowed(value: Float[Array, "... h w"], radius: int) -> Float[Array, "... h w"]:
    """Mean over the square window around each pixel, the border's pixels repeated.

    Args:
        value: a picture, or a stack of them.
        radius: pixels from the middle of the window to its border; 0 is the pixel alone.
    """
    side = 2 * radius + 1
    pad = [(0, 0)] * (value.ndim - 2) + [(radius, radius)] * 2
    padded = jnp.pad(value, pad, mode="edge")
    window = (1,) * (value.ndim - 2) + (side, side)
    total = jax.lax.reduce_window(padded, 0.0, jax.lax.add, window, (1,) * value.ndim, "VALID")
    return total / side**2


def _best(every, step, modes):
    """The best of the candidates of all families, apart from each other."""
    cost, taken = every.cost, []
    for _ in range(modes):
        best = jnp.argmin(cost, axis=0)[None]
        taken.append(
            DepthCandidates(
                jnp.take_along_axis(every.inverse, best, axis=0)[0],
                jnp.take_along_axis(every.normal, best[:, None], axis=0)[0],
                jnp.take_along_axis(every.cost, best, axis=0)[0],
            )
        )
        close = jnp.abs(every.inverse - taken[-1].inverse[None]) <= _APART * step
        cost = jnp.where(close, 3, cost)
    return DepthCandidates(*(jnp.stack(x) for x in zip(*taken, strict=True)))
