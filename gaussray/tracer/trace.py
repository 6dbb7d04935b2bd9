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
from gaussray.tracer import cuda, kernel
from gaussray.tracer.bundle import FAN, bound
from gaussray.tracer.composite import Pixels
from gaussray.tracer.grid import Grid, build
from gaussray.tracer.march import march
from gaussray.tracer.motion import Motion, control_weights, whole, within
from gaussray.tracer.table import Lanes, columns, table
from gaussray.tracer.traverse import Candidates, Capacity, candidates
from gaussray.tracer.window import Living, living


BACKENDS = ("auto", "array", "kernel")


class TraceOptions(eqx.Module):
    """Everything static about a trace; changing a field recompiles.

    `k` hits are taken per round; rounds go on until the transmittance falls to `transmittance_min`
    or nothing is left, so k is a matter of speed alone. `bundle` is the side of a square bundle in
    pixels, `levels` the number of coarser bundle levels (0 for bundles that are not neighbours;
    pictures of millions of Gaussians get more than asked for), `group` how many bundles march
    together (0: 4 on a CPU, whose caches they fill, 16 on a GPU), `chunk` how many list entries are
    read at once. `backend` is "array" (runs everywhere, in any
    precision), "kernel" (single precision on a CUDA device, see kernel.py) or "auto": the kernel
    where it runs.
    """

    k: int = eqx.field(static=True, default=16)
    alpha_min: float = eqx.field(static=True, default=1 / 255)
    alpha_max: float = eqx.field(static=True, default=0.99)
    transmittance_min: float = eqx.field(static=True, default=1e-4)
    bundle: int = eqx.field(static=True, default=8)
    levels: int = eqx.field(static=True, default=1)
    group: int = eqx.field(static=True, default=0)
    chunk: int = eqx.field(static=True, default=16)
    backend: str = eqx.field(static=True, default="auto")

    def __check_init__(self):
        for name in ("k", "bundle", "chunk"):
            if getattr(self, name) < 1:
                raise ValueError(f"trace.{name} must be at least 1, got {getattr(self, name)}.")
        if self.backend not in BACKENDS:
            raise ValueError(f"trace.backend must be one of {BACKENDS}, got {self.backend!r}.")
        if self.group < 0:
            raise ValueError(f"trace.group must be at least 0, got {self.group}.")
        if not 0 <= self.levels <= 4:
            raise ValueError(f"trace.levels must be from 0 to 4, got {self.levels}.")
        if not 0 < self.alpha_min < self.alpha_max < 1:
            raise ValueError(
                "trace.alpha_min and trace.alpha_max must satisfy 0 < alpha_min < alpha_max < 1, "
                f"got {self.alpha_min} and {self.alpha_max}."
            )
        if not 0 <= self.transmittance_min < 1:
            raise ValueError(
                f"trace.transmittance_min must be in [0, 1), got {self.transmittance_min}."
            )


class Report(eqx.Module):
    """What a trace cost and whether it was whole: `needed` sizes in the order of `Capacity` (that
    of transient Gaussians if there are any), entries `dropped` for lack of capacity, Gaussians
    `skipped` because they were not finite, `hits` of all rays together, which may be more than 32
    bits count: exact up to 2^24, then rounded."""

    needed: Int[Array, " sizes"]
    dropped: Int[Array, ""]
    skipped: Int[Array, ""]
    hits: Float[Array, ""]


class Prepared(eqx.Module):
    """A motion as all rays within a `span` of time may meet it.

    `motion` holds of the transient Gaussians those that are `living` in the span (None: there are
    no transient ones). `grid` is the one over them (None where the CUDA kernels trace).
    """

    motion: Motion
    grid: Grid | None
    span: Float[Array, "2"]
    living: Living | None = None

    def extended(self, needed: Array, dropped: Array) -> tuple[Array, Array]:
        """List sizes with the number of living transients, and entries without a place."""
        if self.living is None:
            return needed, dropped
        lost = jnp.maximum(self.living.needed - self.living.index.shape[0], 0)
        return jnp.append(needed, self.living.needed), dropped + lost

    def skipped(self, others: Array) -> Array:
        """How many Gaussians are not finite, given how many of the `others` are not."""
        return others if self.living is None else others + self.living.unusable


def prepare(
    motion: Motion, span: Float[Array, "2"], *, options: TraceOptions, capacity: Capacity
) -> Prepared:
    """What all traces of rays within a span of time share: worth it for several traces.

    Args:
        motion: the scene.
        span: the earliest and the latest time of any ray.
        options: how it will be traced.
        capacity: that of the traces.
    """
    chosen, transient = None, motion.transient
    span = jax.lax.stop_gradient(span)
    if transient is not None:
        # At least one place: an array of nothing is no operand of a kernel.
        places, seen = max(capacity.transient, 1), within(motion.time_range, span)
        if transient.count:
            chosen = living(transient, seen, places, options.alpha_min)
        motion = replace(motion, transient=None if chosen is None else chosen.transients)
    grid = None
    if not on_kernel(options, motion.gaussians.mean.dtype):
        motion = whole(motion)
        fixed = jax.lax.stop_gradient(motion)
        grid = build(fixed, alpha_min=options.alpha_min, span=span)
    return Prepared(motion, grid, span, chosen)


def prepared_for(
    motion: Motion | Prepared, rays: Rays, options: TraceOptions, capacity: Capacity
) -> Prepared:
    """A motion prepared for these rays, unless it is prepared already."""
    if isinstance(motion, Prepared):
        return motion
    return prepare(motion, span_of(rays), options=options, capacity=capacity)


def span_of(rays: Rays) -> Float[Array, "2"]:
    """The earliest and the latest time of rays; times that are not finite do not count."""
    time = jax.lax.stop_gradient(rays.time)
    real = jnp.isfinite(time)
    low = jnp.min(jnp.where(real, time, jnp.inf), initial=jnp.inf)
    return jnp.stack([low, jnp.max(jnp.where(real, time, -jnp.inf), initial=-jnp.inf)])


def trace(
    motion: Motion | Prepared,
    rays: Rays,
    *,
    options: TraceOptions,
    capacity: Capacity,
) -> tuple[Pixels, Report]:
    """What rays see of a moving scene, with gradients to scene, rays and times.

    Every `bundle`^2 consecutive rays form a bundle, so rays should come in a coherent order
    (`bundle.tiles` for pictures, `bundle.coherent_order` for any others). Their number need not
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


def on_kernel(options: TraceOptions, dtype: DTypeLike) -> bool:
    """Whether the CUDA kernel traces rays of this precision."""
    single = jnp.dtype(dtype) == jnp.float32
    if options.backend == "kernel" and not single:
        raise ValueError(
            f"trace.backend=kernel is for single precision, the rays are {jnp.dtype(dtype)}. "
            "Choose trace.backend=array."
        )
    if options.backend == "kernel" and not cuda.available():
        raise ValueError(
            "trace.backend=kernel needs a CUDA device and NVIDIA's run-time compiler: install "
            "'gaussray[cuda]', or choose trace.backend=array."
        )
    return options.backend != "array" and single and cuda.available()


def _trace_kernel(
    scene: Prepared, rays: Rays, *, options: TraceOptions, capacity: Capacity
) -> tuple[Pixels, Report]:
    samples, count = rays.time.shape
    stage, strips = kernel.prepare(
        scene.motion, rays, scene.span, options=options, slots=capacity.slots
    )

    def one(strip: kernel.Strip):
        lists = kernel.candidates(stage, strip)
        sums, transmittance, hits = kernel.march(stage.program, stage.rows, strip, lists)
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
    motion, count = scene.motion, rays.time.shape[1]
    lists, skipped = find(scene, rays, options=options, capacity=capacity)
    rows, layout = table(motion), columns(motion)

    def one(rays: Rays):
        channels, transmittance, hits = march(
            rows,
            lanes_of(motion, in_bundles(rays, options)),
            (lists.index, lists.start, lists.count),
            options,
            layout,
            capacity.slots,
        )
        flat = channels.reshape(4, -1)[:, :count]
        pixels = Pixels(flat[:3].T, transmittance.reshape(-1)[:count], flat[3])
        return pixels, total_hits(hits)

    pixels, hits = over(one, rays)
    return pixels, Report(lists.needed, lists.dropped, skipped, jnp.sum(hits))


def lanes_of(motion: Motion, bundled: Rays) -> Lanes:
    """Bundles of rays with their components first, and what the motion asks of their times."""
    leading = partial(jnp.moveaxis, source=-1, destination=0)
    weights = jax.vmap(jax.vmap(partial(control_weights, motion.time)))(bundled.time)
    time = None
    if motion.transient is not None and not motion.transient.count:
        motion = replace(motion, transient=None)
    if motion.transient is not None:
        time = within(motion.time_range, bundled.time)[None]
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
        grid = build(motion, alpha_min=options.alpha_min, span=scene.span)
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
        stage, strips = kernel.prepare(
            scene.motion, rays, scene.span, options=options, slots=capacity.slots
        )
        counts = over(lambda strip: kernel.candidates(stage, strip).count, strips)
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
        wanted = enlarge(trial, needed, headroom=headroom)
        if int(dropped) == 0:
            return enlarge(Capacity((1,) * (options.levels + 1), 1, 1), needed, headroom=headroom)
        trial = wanted


def enlarge(capacity: Capacity, needed: list[int], *, headroom: float = 1.3) -> Capacity:
    """The capacity with every size that `needed` exceeds, or nearly (0.8 of it), raised, with
    head-room: where lists grow, one new compilation serves them all.

    Sizes are rounded up to an eighth of a power of two, so that growth recompiles rarely; slots to
    a power of two, which is room enough.
    """

    def size(held: int, wanted: int, near: float = 0.8) -> int:
        if wanted <= near * held:
            return held
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
