"""The tracer: candidates of ray bundles, then the march of the bundles."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from gaussray.camera.rays import Rays, moved_to_start
from gaussray.runtime.devices import numba_module
from gaussray.tracer import kernel
from gaussray.tracer.bundle import bounds_of_levels, split_into_bundles
from gaussray.tracer.composite import Pixels, from_origin
from gaussray.tracer.grid import build_grid
from gaussray.tracer.march import march
from gaussray.tracer.motion import Motion, clipped_time, control_weights, lit
from gaussray.tracer.options import (
    TraceOptions,
    on_cpu_kernel,
    on_kernel,
)
from gaussray.tracer.prepare import (
    Prepared,
    prepare_for_rays,
)
from gaussray.tracer.table import Lanes, gaussian_table, table_columns
from gaussray.tracer.traverse import Candidates, Capacity, candidates


class Report(eqx.Module):
    """Cost and completeness of a trace.

    Args:
        needed: needed list sizes, in the order of `Capacity` (`transient` only if there are any).
        dropped: entries that were dropped for lack of capacity; 0 if the result is complete.
        skipped: Gaussians that were skipped because they were not finite.
        hits: hits of all rays together, in single precision: exact up to 2^24, then rounded.
    """

    needed: Int[Array, " sizes"]
    dropped: Int[Array, ""]
    skipped: Int[Array, ""]
    hits: Float[Array, ""]

    def largest_needed(self) -> list[int]:
        """The needed list sizes, of several parts the largest. On the host."""
        needed = np.asarray(self.needed)
        return [int(n) for n in needed.reshape(-1, needed.shape[-1]).max(axis=0)]


def trace(
    motion: Motion | Prepared,
    rays: Rays,
    *,
    options: TraceOptions,
    capacity: Capacity,
) -> tuple[Pixels, Report]:
    """Trace rays through a moving scene: the pixels of the rays, and a report on the list sizes.

    Gradients reach scene, rays and times. Hits at exactly one distance are blended in a fixed
    order: that of the grid (array backend), that of the Gaussians (on a CPU in machine code), or
    that in which their reach begins on the neighbouring rays and then their own (on a GPU).

    Args:
        motion: the scene across the times of the rays, or the result of `prepare`.
        rays: of unit direction (zero meets nothing), in any number; every `bundle`^2 are a bundle,
            so in a coherent order (`bundle.morton_tiles` of a picture, else `coherent_order`). A
            leading axis holds samples (of aperture, exposure), which share a bundle's candidates.
        options: how to trace.
        capacity: sizes of the lists, from `measure`.
    """
    if rays.time.ndim == 1:
        pixels, report = trace(motion, with_sample_axis(rays), options=options, capacity=capacity)
        return jax.tree.map(lambda x: x[0], pixels), report
    scene = prepare_for_rays(motion, rays, options, capacity)
    if on_kernel(options, rays.time.dtype):
        return _trace_kernel(scene, rays, options=options, capacity=capacity)
    return _trace_arrays(scene, rays, options=options, capacity=capacity)


def _trace_kernel(
    scene: Prepared, rays: Rays, *, options: TraceOptions, capacity: Capacity
) -> tuple[Pixels, Report]:
    samples, count = rays.time.shape
    stage, strips = kernel.kernel_inputs(
        scene.motion, moved_to_start(rays), scene.span, options=options, slots=capacity.slots
    )

    def one(strip: kernel.Strip):
        lists = kernel.candidate_lists(stage, strip)
        sums, transmittance, hits = kernel.march_kernel(stage.program, stage.rows, strip, lists)
        needed, dropped = slot_needs(lists.count, capacity)
        return sums, transmittance, needed, dropped, total_hits(hits)

    sums, transmittance, needed, dropped, hits = map_leading(one, strips)
    sums = jnp.moveaxis(sums, 0, 1).reshape(samples, -1, 4)[:, :count]
    transmittance = jnp.moveaxis(transmittance, 0, 1).reshape(samples, -1)[:, :count]
    needed, dropped = scene.with_transient_count(jnp.max(needed, axis=0), jnp.sum(dropped))
    report = Report(needed, dropped, scene.skipped_count(stage.skipped), jnp.sum(hits))
    color = lit(scene.motion, sums[..., :3], rays.time)
    return from_origin(Pixels(color, transmittance, sums[..., 3]), rays), report


def total_hits(hits: Int[Array, "..."]) -> Float[Array, ""]:
    """Sum of the hits, in single precision: the sum may exceed 32 bits."""
    return jnp.sum(hits, dtype=jnp.float32)


def map_leading(function: Callable, tree):
    """`lax.map` along the first axis, without a loop if its length is 1.

    Args:
        function: function of one element, whose arrays have no leading axis.
        tree: arrays with a leading axis of equal length.
    """
    if jax.tree.leaves(tree)[0].shape[0] > 1:
        return jax.lax.map(function, tree)
    return jax.tree.map(lambda x: x[None], function(jax.tree.map(lambda x: x[0], tree)))


def slot_needs(count: Array, capacity: Capacity) -> tuple[Array, Array]:
    """`needed` and `dropped` of lists that only have `slots`.

    Args:
        count: how many Gaussians each list holds.
        capacity: sizes of the lists.
    """
    none = jnp.zeros(len(capacity.cells) + 1, jnp.int32)
    needed = jnp.append(none, jnp.max(count))
    return needed, jnp.sum(jnp.maximum(count - capacity.slots, 0), dtype=jnp.int32)


def _trace_arrays(
    scene: Prepared, rays: Rays, *, options: TraceOptions, capacity: Capacity
) -> tuple[Pixels, Report]:
    lists, skipped = find_candidates(scene, rays, options=options, capacity=capacity)
    pixels, hits = march_lists(scene.motion, rays, lists, options=options, slots=capacity.slots)
    return pixels, Report(lists.needed, lists.dropped, skipped, hits)


def march_lists(
    motion: Motion, rays: Rays, lists: Candidates, *, options: TraceOptions, slots: int
) -> tuple[Pixels, Float[Array, ""]]:
    """Trace rays through the lists of their bundles: the pixels, and the number of all hits.

    Args:
        motion: the scene, as `prepare` leaves it.
        rays: samples of the same rays, with a leading axis.
        lists: from `find_candidates`.
        options: how to trace.
        slots: largest length of a list.
    """
    count = rays.time.shape[1]
    rows, layout = gaussian_table(motion), table_columns(motion)
    march_bundles = march_function(options, rows.dtype)

    def one(rays: Rays):
        channels, transmittance, hits = march_bundles(
            rows,
            ray_lanes(motion, split_into_bundles(moved_to_start(rays), options)),
            (lists.index, lists.start, lists.count),
            options,
            layout,
            slots,
        )
        flat = channels.reshape(4, -1)[:, :count]
        color = lit(motion, flat[:3].T, rays.time)
        pixels = Pixels(color, transmittance.reshape(-1)[:count], flat[3])
        return from_origin(pixels, rays), total_hits(hits)

    pixels, hits = map_leading(one, rays)
    return pixels, jnp.sum(hits)


def march_function(options: TraceOptions, dtype: DTypeLike) -> Callable:
    """The function that marches bundles: machine code, compiled here or read from disk, or arrays.

    Args:
        options: how to trace; machine code runs on CPUs with Numba, unless the backend is "array".
        dtype: precision of the rays; machine code is for single precision.
    """
    if not on_cpu_kernel(options, dtype):
        return march
    marching = numba_module("gaussray.tracer.cpu.march")
    marching.register_forward()
    return marching.march_on_cpu


def make_lists_known(options: TraceOptions, dtype: DTypeLike) -> None:
    """Make known to XLA what finds lists in programs from an earlier process.

    Args:
        options: how to trace.
        dtype: precision of the rays.
    """
    if on_cpu_kernel(options, dtype):
        numba_module("gaussray.tracer.cpu.lists").register_lists()


def ray_lanes(motion: Motion, bundled: Rays) -> Lanes:
    """Bundles of rays with their components first, with weights of the motion's control points.

    Args:
        motion: the scene that the rays will meet.
        bundled: the rays, (bundles, rays of a bundle).
    """
    leading = partial(jnp.moveaxis, source=-1, destination=0)
    weights = jax.vmap(jax.vmap(partial(control_weights, motion.time)))(bundled.time)
    time = None
    if motion.transient is not None and not motion.transient.count:
        motion = replace(motion, transient=None)
    if motion.transient is not None:
        time = clipped_time(motion.time_range, bundled.time)[None]
    return Lanes(leading(bundled.origin), leading(bundled.direction), leading(weights), time)


def find_candidates(
    motion: Motion | Prepared,
    rays: Rays,
    *,
    options: TraceOptions,
    capacity: Capacity,
) -> tuple[Candidates, Int[Array, ""]]:
    """The lists of all bundles, and how many Gaussians are not finite. No gradient.

    Args:
        motion: as for `trace`.
        rays: as for `trace`; a bundle has one list for all samples.
        options: as for `trace`.
        capacity: as for `trace`.

    Raises:
        ValueError: the capacity is one for lists without a grid.
    """
    motion, rays = jax.lax.stop_gradient((motion, moved_to_start(with_sample_axis(rays))))
    scene = prepare_for_rays(motion, rays, replace(options, backend="array"), capacity)
    levels = bounds_of_levels(rays, scene.motion.time, options)
    if not capacity.cells:
        if not on_cpu_kernel(options, rays.time.dtype):
            raise ValueError(
                "a capacity without cells is for single precision on a CPU with Numba: measure it "
                "for these rays and options."
            )
        lists, skipped = numba_module("gaussray.tracer.cpu.lists").find_lists(
            scene.motion, levels, scene.span, options=options, capacity=capacity
        )
    else:
        grid = scene.grid
        if grid is None:
            grid = build_grid(scene.motion, alpha_min=options.alpha_min, span=scene.span)
        lists, skipped = candidates(grid, levels, capacity=capacity), grid.dropped
    needed, dropped = scene.with_transient_count(lists.needed, lists.dropped)
    lists = replace(lists, needed=needed, dropped=dropped)
    return lists, scene.skipped_count(skipped)


def with_sample_axis(rays: Rays) -> Rays:
    return rays if rays.time.ndim == 2 else jax.tree.map(lambda x: x[None], rays)
