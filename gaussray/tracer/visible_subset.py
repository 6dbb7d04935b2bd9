"""The part of a scene that a few blocks of rays may meet. All other Gaussians need not be sorted,
listed or differentiated."""

from dataclasses import replace
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaussray.camera.rays import Rays
from gaussray.tracer.alive_transients import rows_under, swept_between, time_window_of
from gaussray.tracer.bundle import Bundles, bound_bundles
from gaussray.tracer.motion import (
    Motion,
    clipped_time,
    control_points,
    map_arrays,
    merge_rest,
)
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.prepare import time_span
from gaussray.tracer.response import reach_radius


# Rounding errors, in units of the last place, that must not hide a Gaussian.
_SLACK = 8


class SeenPart(NamedTuple):
    """The Gaussians of a motion that blocks of rays may meet.

    Args:
        motion: these Gaussians, in a fixed number of places; an empty place has opacity 0.
        needed: the places that persistent and transient ones need.
    """

    motion: Motion
    needed: Int[Array, "2"]


def seen_part(
    motion: Motion,
    rays: Rays,
    *,
    blocks: int,
    places: tuple[int, int],
    options: TraceOptions,
) -> SeenPart:
    """The part of a motion that rays may meet; the first of its Gaussians if there are too many.

    A trace of it gives what a trace of the whole motion gives. Gradients reach the whole motion.

    Args:
        motion: the scene across the times of the rays.
        rays: samples of the same rays, with a leading axis, in blocks of equal length.
        blocks: number of blocks. Each is bounded by half-spaces, so its rays should be coherent.
        places: places for persistent Gaussians and for transient ones.
        options: how the rays are traced.
    """
    motion = merge_rest(motion)
    masks = _seen(motion, rays, blocks, options)
    needed = jnp.stack([jnp.sum(mask, dtype=jnp.int32) for mask in masks])
    index, there = rows_under(masks[0], places[0])

    def pick(x: Array, axis: int = 0) -> Array:
        return jnp.take(x, index, axis, mode="fill", fill_value=1, indices_are_sorted=True)

    kept = map_arrays(pick, motion.gaussians)
    kept = replace(kept, opacity=jnp.where(there, kept.opacity, 0))
    transient = motion.transient
    if transient is not None:
        index, there = rows_under(masks[1], places[1])
        transient = jax.tree.map(pick, transient)
        transient = replace(transient, opacity=jnp.where(there, transient.opacity, 0))
    return SeenPart(replace(motion, gaussians=kept, transient=transient), needed)


def seen_counts(
    motion: Motion, rays: Rays, *, blocks: int, options: TraceOptions
) -> Int[Array, "2"]:
    """How many places `seen_part` needs for persistent and for transient Gaussians.

    Args:
        motion: the scene across the times of the rays.
        rays: samples of the same rays, with a leading axis, in blocks of equal length.
        blocks: number of blocks.
        options: how the rays are traced.
    """
    masks = _seen(merge_rest(motion), rays, blocks, options)
    return jnp.stack([jnp.sum(mask, dtype=jnp.int32) for mask in masks])


def _seen(motion: Motion, rays: Rays, blocks: int, options: TraceOptions) -> tuple[Array, Array]:
    """Which persistent and which transient Gaussians may be met. What is not finite is seen, so
    that the tracer counts it."""
    motion, rays = jax.lax.stop_gradient((motion, rays))
    block = jax.tree.map(
        lambda x: jnp.moveaxis(x.reshape(x.shape[0], blocks, -1, *x.shape[2:]), 0, 1).reshape(
            blocks, -1, *x.shape[2:]
        ),
        rays,
    )
    # Rays come in square bundles: the first row of one shows how a block is turned.
    bounds = bound_bundles(block, motion.time, row=options.bundle)
    g = motion.gaussians
    reach = reach_radius(g.opacity, options.alpha_min)
    mean, frame = control_points(motion)
    if motion.keys == 1:
        longest = jnp.max(g.scale, axis=-1)
    else:
        longest = jnp.sqrt(jnp.sum(frame * frame, axis=(-2, -1)))
    persistent = _touched(bounds, mean, reach[None] * longest) & ~(reach <= 0)
    transient = motion.transient
    if transient is None:
        return persistent, jnp.zeros(0, bool)
    reach = reach_radius(transient.opacity, options.alpha_min)
    span = clipped_time(motion.time_range, time_span(rays))
    swept = swept_between(time_window_of(transient), reach, span[0], span[1])
    ends = jnp.stack([transient.mean + x for x in (swept.first, swept.last)])
    size = reach * swept.shrink * jnp.max(transient.scale, axis=-1)
    briefly = _touched(bounds, ends, jnp.broadcast_to(size, ends.shape[:2]))
    known = jnp.isfinite(transient.instant + transient.lifetime + transient.plateau + reach)
    return persistent, (briefly & ~(swept.shrink <= 0)) | ~known


def _touched(
    bounds: Bundles, center: Float[Array, "keys gaussians 3"], size: Float[Array, "keys gaussians"]
) -> Bool[Array, " gaussians"]:
    """Whether the hull of the spheres of each Gaussian reaches into all half-spaces of a block."""
    eps = _SLACK * jnp.finfo(center.dtype).eps
    # Sums and maxima of few numbers are written out: a CPU takes ten times as long to reduce axes.
    spheres = []
    for key, radius in zip(center, size, strict=True):
        x = [key[:, i] for i in range(3)]
        slack = eps * (jnp.abs(x[0]) + jnp.abs(x[1]) + jnp.abs(x[2]))
        spheres.append((x, radius * (1 + eps) + slack))

    def by(normal: Float[Array, "sides 3"], offset: Float[Array, " sides"]) -> Array:
        inside = jnp.ones(center.shape[1], bool)
        for n, least in zip(normal, offset, strict=True):
            ends = [n[0] * x[0] + n[1] * x[1] + n[2] * x[2] + radius for x, radius in spheres]
            inside = inside & ~(reduce(jnp.maximum, ends) < least)
        return inside

    return reduce(
        jnp.logical_or, [by(n, o) for n, o in zip(bounds.normal, bounds.offset, strict=True)]
    )
