"""Rays through Gaussians: candidates, then the march of the bundles; and what it costs."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from gaussray.camera.rays import Rays
from gaussray.tracer import kernel
from gaussray.tracer.bundle import FAN, bound
from gaussray.tracer.composite import Pixels
from gaussray.tracer.grid import build_grid
from gaussray.tracer.march import march
from gaussray.tracer.motion import Motion, clipped_time, control_weights
from gaussray.tracer.options import (
    BACKENDS as BACKENDS,
    TraceOptions as TraceOptions,
    on_cpu_kernel,
    on_kernel,
)
from gaussray.tracer.prepare import (
    Prepared as Prepared,
    prepare as prepare,
    prepared_for,
    span_of as span_of,
)
from gaussray.tracer.table import Lanes, columns, gaussian_table
from gaussray.tracer.traverse import Candidates, Capacity, candidates


class Report(eqx.Module):
    """What a trace cost and whether it was whole: `needed` sizes in the order of `Capacity` (that
    of transient Gaussians if there are any), entries `dropped` for lack of capacity, Gaussians
    `skipped` because they were not finite, `hits` of all rays together, which may be more than 32
    bits count: exact up to 2^24, then rounded."""

    needed: Int[Array, " sizes"]
    dropped: Int[Array, ""]
    skipped: Int[Array, ""]
    hits: Float[Array, ""]


def trace(
    motion: Motion | Prepared,
    rays: Rays,
    *,
    options: TraceOptions,
    capacity: Capacity,
) -> tuple[Pixels, Report]:
    """What rays see of a moving scene, with gradients to scene, rays and times.

    Every `bundle`^2 consecutive rays form a bundle, so rays should come in a coherent order
    (`bundle.morton_tiles` for pictures, `bundle.coherent_order` for others). Their number need not
    divide evenly. A leading axis holds samples of the same rays (of an aperture, of an exposure):
    they share what their bundle may meet, which is looked for once. Hits at exactly one distance
    come in the order of the grid (arrays), or in that in which the reach of their Gaussians begins
    before the neighbouring rays, and else of the Gaussians (kernels): always the same.

    Args:
        motion: the scene across the times of the rays, or what `prepare` makes of it.
        rays: origin, direction (unit) and time of every ray; zero directions meet nothing.
        options: how to trace.
        capacity: sizes of the lists, from `measure`.

    Returns:
        Pixels of every ray, and the report on list sizes and entries that found no place.
    """
    if rays.time.ndim == 1:
        pixels, report = trace(motion, _sampled(rays), options=options, capacity=capacity)
        return jax.tree.map(lambda x: x[0], pixels), report
    scene = prepared_for(motion, rays, options, capacity)
    if on_kernel(options, rays.time.dtype):
        return _trace_kernel(scene, rays, options=options, capacity=capacity)
    return _trace_arrays(scene, rays, options=options, capacity=capacity)


def _trace_kernel(
    scene: Prepared, rays: Rays, *, options: TraceOptions, capacity: Capacity
) -> tuple[Pixels, Report]:
    samples, count = rays.time.shape
    stage, strips = kernel.stage_and_strips(
        scene.motion, rays, scene.span, options=options, slots=capacity.slots
    )

    def one(strip: kernel.Strip):
        lists = kernel.candidate_lists(stage, strip)
        sums, transmittance, hits = kernel.march_kernel(stage.program, stage.rows, strip, lists)
        needed, dropped = _wants(lists.count, options, capacity)
        return sums, transmittance, needed, dropped, total_hits(hits)

    sums, transmittance, needed, dropped, hits = over(one, strips)
    sums = jnp.moveaxis(sums, 0, 1).reshape(samples, -1, 4)[:, :count]
    transmittance = jnp.moveaxis(transmittance, 0, 1).reshape(samples, -1)[:, :count]
    needed, dropped = scene.extended(jnp.max(needed, axis=0), jnp.sum(dropped))
    report = Report(needed, dropped, scene.skipped(stage.skipped), jnp.sum(hits))
    return Pixels(sums[..., :3], transmittance, sums[..., 3]), report


def total_hits(hits: Int[Array, "..."]) -> Float[Array, ""]:
    """All together, in single precision: they may be more than 32 bits count."""
    return jnp.sum(hits, dtype=jnp.float32)


def over(function: Callable, tree):
    """`lax.map` along the first axis, without its loop where there is but one."""
    if jax.tree.leaves(tree)[0].shape[0] > 1:
        return jax.lax.map(function, tree)
    return jax.tree.map(lambda x: x[None], function(jax.tree.map(lambda x: x[0], tree)))


def _wants(count: Array, options: TraceOptions, capacity: Capacity) -> tuple[Array, Array]:
    """`needed` and `dropped` of lists that only have `slots`."""
    none = jnp.zeros(options.levels + 2, jnp.int32)
    needed = jnp.append(none, jnp.max(count))
    return needed, jnp.sum(jnp.maximum(count - capacity.slots, 0), dtype=jnp.int32)


def _trace_arrays(
    scene: Prepared, rays: Rays, *, options: TraceOptions, capacity: Capacity
) -> tuple[Pixels, Report]:
    lists, skipped = find(scene, rays, options=options, capacity=capacity)
    pixels, hits = march_lists(scene.motion, rays, lists, options=options, slots=capacity.slots)
    return pixels, Report(lists.needed, lists.dropped, skipped, hits)


def march_lists(
    motion: Motion, rays: Rays, lists: Candidates, *, options: TraceOptions, slots: int
) -> tuple[Pixels, Float[Array, ""]]:
    """What rays see of the Gaussians in the lists of their bundles, and all their hits.

    Args:
        motion: the scene, as `prepare` leaves it.
        rays: samples of the same rays, with a leading axis.
        lists: from `find`.
        options: how to trace.
        slots: length of the longest list that there is room for.
    """
    count = rays.time.shape[1]
    rows, layout = gaussian_table(motion), columns(motion)
    marched = march_for(options, rows.dtype)

    def one(rays: Rays):
        channels, transmittance, hits = marched(
            rows,
            lanes_of(motion, in_bundles(rays, options)),
            (lists.index, lists.start, lists.count),
            options,
            layout,
            slots,
        )
        flat = channels.reshape(4, -1)[:, :count]
        pixels = Pixels(flat[:3].T, transmittance.reshape(-1)[:count], flat[3])
        return pixels, total_hits(hits)

    pixels, hits = over(one, rays)
    return pixels, jnp.sum(hits)


def march_for(options: TraceOptions, dtype: DTypeLike) -> Callable:
    """How bundles march: in machine code where that runs on a CPU, which is compiled by now or read
    from disk; else in arrays."""
    if not on_cpu_kernel(options, dtype):
        return march
    # Numba takes as long to import as a small picture to render.
    from gaussray.tracer.cpu_march import march_on_cpu, register_forward

    register_forward()
    return march_on_cpu


def lanes_of(motion: Motion, bundled: Rays) -> Lanes:
    """Bundles of rays with their components first, and what the motion asks of their times."""
    leading = partial(jnp.moveaxis, source=-1, destination=0)
    weights = jax.vmap(jax.vmap(partial(control_weights, motion.time)))(bundled.time)
    time = None
    if motion.transient is not None and not motion.transient.count:
        motion = replace(motion, transient=None)
    if motion.transient is not None:
        time = clipped_time(motion.time_range, bundled.time)[None]
    return Lanes(leading(bundled.origin), leading(bundled.direction), leading(weights), time)


def find(
    motion: Motion | Prepared,
    rays: Rays,
    *,
    options: TraceOptions,
    capacity: Capacity,
) -> tuple[Candidates, Int[Array, ""]]:
    """Lists of every bundle over all samples, and the number of Gaussians that were not finite."""
    motion, rays = jax.lax.stop_gradient((motion, rays))
    scene = prepared_for(motion, rays, replace(options, backend="array"), capacity)
    motion, grid = scene.motion, scene.grid
    if grid is None:
        grid = build_grid(motion, alpha_min=options.alpha_min, span=scene.span)
    each = jax.vmap(lambda one: in_bundles(one, options))(_sampled(rays))
    bundled = jax.tree.map(
        lambda x: jnp.moveaxis(x, 0, 1).reshape(x.shape[1], -1, *x.shape[3:]), each
    )
    levels = [bound(bundled, motion.time)]
    for _ in range(options.levels):
        bundled = jax.tree.map(
            lambda x: x.reshape(x.shape[0] // FAN, FAN * x.shape[1], *x.shape[2:]), bundled
        )
        levels.insert(0, bound(bundled, motion.time))
    lists = candidates(grid, levels, capacity=capacity)
    needed, dropped = scene.extended(lists.needed, lists.dropped)
    lists = replace(lists, needed=needed, dropped=dropped)
    return lists, scene.skipped(grid.dropped)


def _sampled(rays: Rays) -> Rays:
    return rays if rays.time.ndim == 2 else jax.tree.map(lambda x: x[None], rays)


def _sizes(motion, rays, *, options, capacity) -> tuple[Int[Array, " sizes"], Int[Array, ""]]:
    """The list sizes that scene and rays want, and how many entries find no place."""
    if on_kernel(options, rays.time.dtype):
        rays = _sampled(rays)
        scene = prepared_for(motion, rays, options, capacity)
        stage, strips = kernel.stage_and_strips(
            scene.motion, rays, scene.span, options=options, slots=capacity.slots
        )
        counts = over(lambda strip: kernel.candidate_lists(stage, strip).count, strips)
        return scene.extended(*_wants(counts, options, capacity))
    lists, _ = find(motion, rays, options=options, capacity=capacity)
    return lists.needed, lists.dropped


def _alive_count(motion: Motion, rays: Rays, options: TraceOptions) -> Int[Array, ""]:
    """How many transient Gaussians some ray may meet."""
    none = Capacity((), 0, 0)
    scene = prepare(motion, span_of(rays), options=options, capacity=none)
    return jnp.zeros((), jnp.int32) if scene.living is None else scene.living.needed


# Compiled once for all who measure alike.
_search = eqx.filter_jit(_sizes)
_count_alive = eqx.filter_jit(_alive_count)


def measure(
    motion: Motion,
    rays: Rays,
    *,
    options: TraceOptions,
    capacity: Capacity | None = None,
    headroom: float = 1.3,
) -> Capacity:
    """Capacity with head-room for scenes and rays like these. On the host, outside jit.

    Starts from a small guess (or from `capacity`) and grows whatever overflowed until nothing does.
    """
    trial = capacity
    if trial is None:
        bundles = -(-rays.time.shape[-1] // options.bundle**2)
        trial = Capacity((256 * bundles,) * (options.levels + 1), 512 * bundles, 1024)
    if motion.transient is not None and not trial.transient:
        # Known without a search, and all other sizes depend on it.
        trial = replace(trial, transient=max(int(_count_alive(motion, rays, options)), 1))
    while True:
        needed, dropped = _search(motion, rays, options=options, capacity=trial)
        needed = [int(n) for n in needed]
        wanted = enlarged_capacity(trial, needed, headroom=headroom)
        if int(dropped) == 0:
            return enlarged_capacity(
                Capacity((1,) * (options.levels + 1), 1, 1), needed, headroom=headroom
            )
        trial = wanted


def enlarged_capacity(capacity: Capacity, needed: list[int], *, headroom: float = 1.3) -> Capacity:
    """The capacity with every size that `needed` exceeds, or nearly (0.8 of it), raised, with
    head-room: where lists grow, one new compilation serves them all.

    Sizes are rounded up to an eighth of a power of two, so that growth recompiles rarely; slots to
    a power of two, which is room enough.
    """

    def size(present: int, wanted: int, near: float = 0.8) -> int:
        if wanted <= near * present:
            return present
        target = max(int(wanted * headroom), 16)
        step = max(1 << (target.bit_length() - 3), 1)
        return -(-target // step) * step

    levels = len(capacity.cells)
    cells, (pairs, slots, *transient) = needed[:levels], needed[levels:]
    return Capacity(
        cells=tuple(size(h, w) for h, w in zip(capacity.cells, cells, strict=True)),
        pairs=size(capacity.pairs, pairs),
        slots=1 << max(size(capacity.slots, slots, near=1.0) - 1, 1).bit_length(),
        transient=size(capacity.transient, *transient) if transient else capacity.transient,
    )


def in_bundles(rays: Rays, options: TraceOptions) -> Rays:
    """Rays as bundles x rays of one bundle; what is missing is filled with rays that meet
    nothing (direction zero)."""
    each = options.bundle**2
    block = each * FAN**options.levels
    count = rays.time.shape[0]
    padding = max(-(-count // block), 1) * block - count

    def split(x: Array) -> Array:
        x = jnp.pad(x, ((0, padding),) + ((0, 0),) * (x.ndim - 1))
        return x.reshape(-1, each, *x.shape[1:])

    return jax.tree.map(split, rays)
