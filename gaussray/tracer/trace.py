"""Rays through Gaussians: candidates, then the march of the bundles; and what it costs."""

import math
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from gaussray.camera.rays import Rays
from gaussray.tracer.bundle import FAN, bound
from gaussray.tracer.composite import Pixels
from gaussray.tracer.grid import build
from gaussray.tracer.march import march
from gaussray.tracer.motion import Motion, columns, control_weights, table
from gaussray.tracer.traverse import Candidates, Capacity, candidates


class TraceOptions(eqx.Module):
    """Everything static about a trace; changing a field recompiles.

    `k` hits are taken per round; rounds go on until the transmittance falls to `transmittance_min`
    or nothing is left, so k is a matter of speed alone. `bundle` is the side of a square bundle in
    pixels, `levels` the number of coarser bundle levels (0 for bundles that are not neighbours),
    `group` how many bundles march together (0: 4 on a CPU, whose caches they fill, 16 on a GPU),
    `chunk` how many list entries are read at once.
    """

    k: int = eqx.field(static=True, default=16)
    alpha_min: float = eqx.field(static=True, default=1 / 255)
    alpha_max: float = eqx.field(static=True, default=0.99)
    transmittance_min: float = eqx.field(static=True, default=1e-4)
    bundle: int = eqx.field(static=True, default=8)
    levels: int = eqx.field(static=True, default=1)
    group: int = eqx.field(static=True, default=0)
    chunk: int = eqx.field(static=True, default=16)

    def __check_init__(self):
        for name in ("k", "bundle", "chunk"):
            if getattr(self, name) < 1:
                raise ValueError(f"trace.{name} must be at least 1, got {getattr(self, name)}.")
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
    """What a trace cost and whether it was whole: `needed` list sizes (see `Capacity`), entries
    `dropped` for lack of capacity, Gaussians `skipped` because they were not finite, `hits` of all
    rays together."""

    needed: Int[Array, " sizes"]
    dropped: Int[Array, ""]
    skipped: Int[Array, ""]
    hits: Int[Array, ""]


def trace(
    motion: Motion, rays: Rays, *, options: TraceOptions, capacity: Capacity
) -> tuple[Pixels, Report]:
    """What rays see of a moving scene, with gradients to scene, rays and times.

    Every `bundle`^2 consecutive rays form a bundle, so rays should come in a coherent order
    (`bundle.tiles` for pictures, `bundle.coherent_order` for any others). Their number need not
    divide evenly.
    """
    count = rays.time.shape[0]
    lists, skipped = find(motion, rays, options=options, capacity=capacity)
    bundled = _bundle(rays, options)
    weights = jax.vmap(jax.vmap(partial(control_weights, motion.time)))(bundled.time)
    leading = partial(jnp.moveaxis, source=-1, destination=0)
    channels, transmittance, hits = march(
        table(motion),
        leading(bundled.origin),
        leading(bundled.direction),
        leading(weights),
        (lists.index, lists.start, lists.count),
        options,
        columns(motion),
        max(math.ceil(math.log2(max(capacity.slots, 2))), 1),
    )
    flat = channels.reshape(4, -1)[:, :count]
    pixels = Pixels(flat[:3].T, transmittance.reshape(-1)[:count], flat[3])
    return pixels, Report(lists.needed, lists.dropped, skipped, jnp.sum(hits))


def find(
    motion: Motion, rays: Rays, *, options: TraceOptions, capacity: Capacity
) -> tuple[Candidates, Int[Array, ""]]:
    """Candidate lists of every bundle, and the number of Gaussians that were not finite."""
    motion, rays = jax.lax.stop_gradient((motion, rays))
    grid = build(motion, alpha_min=options.alpha_min)
    bundled = _bundle(rays, options)
    levels = [bound(bundled, motion.time)]
    for _ in range(options.levels):
        bundled = jax.tree.map(
            lambda x: x.reshape(x.shape[0] // FAN, FAN * x.shape[1], *x.shape[2:]), bundled
        )
        levels.insert(0, bound(bundled, motion.time))
    return candidates(grid, levels, capacity=capacity), grid.dropped


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
    search = eqx.filter_jit(find)
    if capacity is None:
        bundles = -(-rays.time.shape[0] // options.bundle**2)
        capacity = Capacity((256 * bundles,) * (options.levels + 1), 512 * bundles, 1024)
        trial = capacity
    else:
        trial = capacity
    while True:
        lists, _ = search(motion, rays, options=options, capacity=trial)
        needed = [int(n) for n in lists.needed]
        wanted = enlarge(trial, needed, headroom=headroom)
        if int(lists.dropped) == 0:
            return enlarge(Capacity((1,) * (options.levels + 1), 1, 1), needed, headroom=headroom)
        trial = wanted


def enlarge(capacity: Capacity, needed: list[int], *, headroom: float = 1.3) -> Capacity:
    """The capacity with every size that `needed` exceeds (nearly) raised, with head-room.

    Sizes are rounded up to an eighth of a power of two, so that growth recompiles rarely.
    """

    def size(held: int, wanted: int) -> int:
        if wanted <= held:
            return held
        target = max(int(wanted * headroom), 16)
        step = max(1 << (target.bit_length() - 3), 1)
        return -(-target // step) * step

    *cells, pairs, slots = needed
    return Capacity(
        cells=tuple(size(h, w) for h, w in zip(capacity.cells, cells, strict=True)),
        pairs=size(capacity.pairs, pairs),
        slots=1 << max(size(capacity.slots, slots) - 1, 1).bit_length(),
    )


def _bundle(rays: Rays, options: TraceOptions) -> Rays:
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
