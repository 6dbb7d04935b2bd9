"""Rays through Gaussians: candidates, nearest hits in rounds, colour."""

import math
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from gaussray.camera.rays import Rays
from gaussray.scene.harmonics import radiance
from gaussray.tracer import motion as motion_
from gaussray.tracer.bundle import FAN, bound
from gaussray.tracer.composite import Pixels, composite
from gaussray.tracer.grid import build
from gaussray.tracer.motion import Motion, key_weights, state_at
from gaussray.tracer.response import opacity_on_ray, reach, response
from gaussray.tracer.traverse import Candidates, Capacity, candidates, nearest, pack


class TraceOptions(eqx.Module):
    """Everything static about a trace; changing a field recompiles.

    `k` hits are taken per round; rounds go on until the transmittance falls to `transmittance_min`
    or nothing is left, so k is a matter of speed alone. `bundle` is the side of a square bundle in
    pixels, `levels` the number of coarser bundle levels (0 for bundles that are not neighbours),
    `group` how many bundles march together, `chunk` how many list entries are read at once.
    """

    k: int = eqx.field(static=True, default=16)
    alpha_min: float = eqx.field(static=True, default=1 / 255)
    alpha_max: float = eqx.field(static=True, default=0.99)
    transmittance_min: float = eqx.field(static=True, default=1e-4)
    bundle: int = eqx.field(static=True, default=8)
    levels: int = eqx.field(static=True, default=1)
    group: int = eqx.field(static=True, default=16)
    chunk: int = eqx.field(static=True, default=16)

    def __check_init__(self):
        for name in ("k", "bundle", "group", "chunk"):
            if getattr(self, name) < 1:
                raise ValueError(f"trace.{name} must be at least 1, got {getattr(self, name)}.")
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
    weights = jax.vmap(jax.vmap(partial(key_weights, motion.time)))(bundled.time)
    leading = partial(jnp.moveaxis, source=-1, destination=0)
    channels, transmittance, hits = _march(
        motion_.table(motion),
        leading(bundled.origin),
        leading(bundled.direction),
        leading(weights),
        (lists.index, lists.start, lists.count),
        options,
        motion.keys,
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
        capacity = Capacity((32 * bundles,) * (options.levels + 1), 128 * bundles, 256)
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


@partial(jax.custom_vjp, nondiff_argnums=(5, 6, 7))
def _march(table, origin, direction, weights, lists, options, keys, bits):
    """All bundles, in groups of similar list length: channels (red, green, blue, depth), T, hits.

    Backward (custom because the number of rounds is only known at run time, and to keep nothing
    but the result and the hits of the first round, mostly the only one): the rounds are walked again front to back. With round r contributing
    T_r L_r to the sum and T_{r+1} = T_r tau_r, dL_r = T_r g and
    dtau_r = (g . (total - sum up to r) + g_T T_end) / tau_r; shading is then differentiated by JAX.
    """
    return _forward(table, origin, direction, weights, lists, options, keys, bits)[0]


def _forward(table, origin, direction, weights, lists, options, keys, bits):
    groups, restore = _groups(origin, direction, weights, lists, options)
    geometry = _geometry(table, keys, options)

    def group(one):
        listed = _list_keys(geometry, one, lists[0], options, keys, bits)

        def body(state):
            (channels, transmittance, after, hits, _), first = state
            found = _round(listed, one, lists[0], after, options, bits)
            index, there, last, full = found
            rows = _components(table, index)
            local, tau = _shade(rows, one["o"], one["d"], one["w"], there, options)
            channels = channels + transmittance[None] * local
            transmittance = transmittance * tau
            going = full & (transmittance > options.transmittance_min)
            after = jnp.where(going, last, _END[last.dtype])
            beginning = jnp.all(hits == 0)
            first = jax.tree.map(lambda new, old: jnp.where(beginning, new, old), found, first)
            hits = hits + jnp.sum(there, axis=0, dtype=jnp.int32)
            return (channels, transmittance, after, hits, jnp.any(going)), first

        start = _start(one, table.dtype)
        shape = (options.k, *start[1].shape)
        nothing = (
            jnp.full(shape, -1, jnp.int32),
            jnp.zeros(shape, bool),
            start[2],
            jnp.zeros(start[1].shape, bool),
        )
        final, first = jax.lax.while_loop(lambda s: s[0][4], body, (start, nothing))
        return (final[0], final[1], final[3]), first

    results, first = jax.lax.map(group, groups)
    return restore(results), first


def _march_forward(table, origin, direction, weights, lists, options, keys, bits):
    out, first = _forward(table, origin, direction, weights, lists, options, keys, bits)
    return out, (table, origin, direction, weights, lists, out[0], out[1], first)


def _march_backward(options, keys, bits, saved, cotangent):
    table, origin, direction, weights, lists, total, end, first = saved
    g_channels, g_end, _ = cotangent
    groups, restore = _groups(origin, direction, weights, lists, options)
    geometry = _geometry(table, keys, options)
    extra = _split({"total": total, "end": end, "g": g_channels, "g_end": g_end}, lists, options)

    def group(d_table, one):
        one, more, first = one

        def shade_back(state, found):
            channels, transmittance, _, d_table, d_rays, _ = state
            index, there, last, full = found
            rows = _components(table, index)
            (local, tau), pull = jax.vjp(
                lambda rows, o, d, w: _shade(rows, o, d, w, there, options),
                rows,
                one["o"],
                one["d"],
                one["w"],
            )
            channels = channels + transmittance[None] * local
            rest = jnp.sum(more["g"] * (more["total"] - channels), axis=0)
            rest = rest + more["g_end"] * more["end"]
            live = tau > jnp.finfo(tau.dtype).tiny
            d_tau = jnp.where(live, rest / jnp.where(live, tau, 1), 0)
            d_rows, d_o, d_d, d_w = pull((transmittance[None] * more["g"], d_tau))
            d_rows = jnp.stack(d_rows, axis=-1)
            # Rays that are done and empty slots carry zeros, to the row of nothing.
            d_table = d_table.at[index.reshape(-1)].add(d_rows.reshape(-1, d_rows.shape[-1]))
            d_rays = jax.tree.map(jnp.add, d_rays, (d_o, d_d, d_w))
            transmittance = transmittance * tau
            going = full & (transmittance > options.transmittance_min)
            after = jnp.where(going, last, _END[last.dtype])
            return channels, transmittance, after, d_table, d_rays, jnp.any(going)

        def further_rounds(state):
            listed = _list_keys(geometry, one, lists[0], options, keys, bits)

            def body(state):
                found = _round(listed, one, lists[0], state[2], options, bits)
                return shade_back(state, found)

            return jax.lax.while_loop(lambda s: s[5], body, state)

        channels, transmittance, after, _, going = _start(one, table.dtype)
        zeros = jax.tree.map(jnp.zeros_like, (one["o"], one["d"], one["w"]))
        state = (channels, transmittance, after, d_table, zeros, going)
        state = shade_back(state, first)
        final = jax.lax.cond(state[5], further_rounds, lambda state: state, state)
        return final[3], final[4]

    d_table, d_rays = jax.lax.scan(group, jnp.zeros_like(table), (groups, extra, first))
    return (d_table, *restore(d_rays), None)


_march.defvjp(_march_forward, _march_backward)

# Beyond this key nothing is left.
_END = {jnp.dtype("int32"): 2**31 - 1, jnp.dtype("int64"): 2**63 - 1}


def _start(one, dtype):
    rays = one["o"].shape[1:]
    kind = jnp.int64 if dtype == jnp.float64 else jnp.int32
    return (
        jnp.zeros((4, *rays), dtype),
        jnp.ones(rays, dtype),
        jnp.full(rays, -1, kind),
        jnp.zeros(rays, jnp.int32),
        jnp.max(one["count"]) > 0,
    )


def _geometry(table, keys, options):
    """What finding hits needs: frame and mean at each key, and the squared reach."""
    opacity = table[:, 12 * keys]
    squared = reach(opacity, options.alpha_min) ** 2
    return jax.lax.stop_gradient(jnp.concatenate([table[:, : 12 * keys], squared[:, None]], axis=1))


def _split(tree, lists, options):
    """Arrays (channels x bundles x rays) -> groups x channels x bundles of a group x rays."""
    order = jnp.argsort(lists[2])
    bundles = order.shape[0]
    groups = -(-bundles // options.group)
    order = jnp.pad(order, (0, groups * options.group - bundles), constant_values=-1)

    def split(x):
        picked = jnp.where((order >= 0).reshape((1,) * (x.ndim - 2) + (-1, 1)), x[..., order, :], 0)
        parts = picked.reshape(*x.shape[:-2], groups, options.group, x.shape[-1])
        return jnp.moveaxis(parts, -3, 0)

    return jax.tree.map(split, tree)


def _groups(origin, direction, weights, lists, options):
    """Bundles sorted by list length and cut into groups, and the way back."""
    _, start, count = lists
    order = jnp.argsort(count)
    bundles = order.shape[0]
    groups = -(-bundles // options.group)
    padding = groups * options.group - bundles
    parts = _split({"o": origin, "d": direction, "w": weights}, lists, options)
    for name, x in (("start", start), ("count", count)):
        parts[name] = jnp.pad(x[order], (0, padding)).reshape(groups, options.group)
    back = jnp.argsort(order)

    def restore(tree):
        def join(x):
            x = jnp.moveaxis(x, 0, -3)
            x = x.reshape(*x.shape[:-3], groups * options.group, x.shape[-1])
            return x[..., back, :]

        return jax.tree.map(join, tree)

    return parts, restore


def _list_keys(geometry, one, index, options, keys, bits):
    """Sort keys of every (list entry, ray) of a group, evaluated once and kept for all rounds.

    Chunks x entries of a chunk x bundles x rays; only as many chunks are filled as the longest list
    of the group wants.
    """
    lanes = jnp.arange(options.chunk, dtype=jnp.int32)
    o, d, w = one["o"][:, None], one["d"][:, None], one["w"][:, None]
    kind = jnp.int64 if o.dtype == jnp.float64 else jnp.int32
    shape = (-(-(1 << bits) // options.chunk), options.chunk, *o.shape[2:])

    def fill(i, state):
        kept, low, high = state
        slot = i * options.chunk + lanes
        place = one["start"][None, :] + slot[:, None]
        rows = geometry[jnp.maximum(index.at[place].get(mode="clip"), 0)]
        row = [rows[..., i, None] for i in range(rows.shape[-1])]
        listed = slot[:, None] < one["count"][None, :]
        t, q = response(*state_at(row, w), o, d)
        met = listed[..., None] & (q < row[-1]) & (t > 0)
        order = jax.lax.bitcast_convert_type(t, kind)
        order = jnp.where(met, order, end)
        low = jnp.minimum(low, jnp.min(order, axis=0))
        high = jnp.maximum(high, jnp.max(jnp.where(met, order, 0), axis=0))
        return kept.at[i].set(order), low, high

    def finish(i, kept):
        slot = (i * options.chunk + lanes)[:, None, None]
        order = kept[i]
        key = pack(order, slot, low[None], high[None], bits)
        return kept.at[i].set(jnp.where(order == end, end, key))

    chunks = -(-jnp.max(one["count"]) // options.chunk)
    end = _END[jnp.dtype(kind)]
    empty = (jnp.empty(shape, kind), jnp.full(shape[2:], end, kind), jnp.zeros(shape[2:], kind))
    kept, low, high = jax.lax.fori_loop(0, chunks, fill, empty)
    return jax.lax.fori_loop(0, chunks, finish, kept), chunks


def _round(listed, one, index, after, options, bits):
    """The next k hits of every ray: Gaussian indices, which slots are filled, the last key, and
    whether there may be more."""
    kept = nearest(*listed, after, k=options.k)
    there = kept != _END[kept.dtype]
    slot = jnp.where(there, kept & ((1 << bits) - 1), 0).astype(jnp.int32)
    place = one["start"][None, :, None] + slot
    # The last row of the table is harmless: nothing that an empty slot shades can overflow.
    hits = jnp.where(there, index.at[place].get(mode="clip"), -1)
    return hits, there, kept[-1], there[-1]


def _components(table, index):
    """Rows of the table for every hit, one array per column."""
    rows = table[index]
    return [rows[..., i] for i in range(table.shape[1])]


def _shade(rows, origin, direction, weights, there, options):
    """Channels and transmittance of one round of hits (columns of k x bundles x rays)."""
    keys = weights.shape[0]
    origin, direction, weights = origin[:, None], direction[:, None], weights[:, None]
    whiten, mean = state_at(rows, weights)
    t, q = response(whiten, mean, origin, direction)
    alpha = opacity_on_ray(rows[12 * keys], q, alpha_max=options.alpha_max)
    alpha = jnp.where(there, alpha, 0)
    harmonics = jnp.stack(rows[12 * keys + 1 :])
    harmonics = harmonics.reshape(-1, 3, *harmonics.shape[1:])
    color = radiance(harmonics, direction)
    payload = jnp.concatenate([color, t[None]])
    return composite(alpha, t, payload)
