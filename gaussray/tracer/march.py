"""Bundles march through their candidates: the nearest hits, round by round, and their colour."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from gaussray.scene.harmonics import radiance
from gaussray.tracer.composite import composite
from gaussray.tracer.k_nearest import nearest_hits, slot_mask, sort_key
from gaussray.tracer.response import opacity_on_ray, reach
from gaussray.tracer.table import Lanes, meet, tint_at


def _march(table, lanes, lists, options, columns, room) -> tuple[Array, Array, Array]:
    """All bundles, in groups of similar list length: channels (red, green, blue, depth), T, hits.

    Backward (custom because the number of rounds is only known at run time, and to keep nothing
    but the result and the nearest _KEPT hits, mostly all there are): the rounds are walked again
    front to back. With round r contributing T_r L_r to the sum and T_{r+1} = T_r tau_r,
    dL_r = T_r g and dtau_r = (g . (total - sum up to r) + g_T T_end) / tau_r; shading is then
    differentiated by JAX.
    """
    return _forward(table, lanes, lists, options, columns, room)[0]


def _forward(table, lanes, lists, options, columns, room):
    groups, restore = _groups(lanes, lists, options)
    geometry, paint = _geometry(table, columns, options), table[:, columns.opacity + 1 :]

    def group(space, one):
        listed = _list_keys(space, geometry, one, lists[0], options, columns)

        def body(state):
            (channels, transmittance, after, hits, _), r, kept = state
            found, slot = _round(listed, one, lists[0], after, options)
            index, last = found
            there = index >= 0
            t, alpha = _at_slots(listed, slot, there)
            rows = _components(paint, index)
            local, tau = _blended(rows, t, alpha, one["lanes"], columns)
            channels = channels + transmittance[None] * local
            transmittance = transmittance * tau
            going = there[-1] & (transmittance > options.transmittance_min)
            after = jnp.where(going, last, _END[last.dtype])
            kept = jax.tree.map(lambda x, new: x.at[r].set(new, mode="drop"), kept, found)
            hits = hits + jnp.sum(there, axis=0, dtype=jnp.int32)
            return (channels, transmittance, after, hits, jnp.any(going)), r + 1, kept

        start = _start(one, table.dtype)
        rounds, after = _kept_rounds(options), start[2]
        kept = (
            jnp.full((rounds, options.k, *after.shape), -1, jnp.int32),
            jnp.zeros((rounds, *after.shape), after.dtype),
        )
        final, _, kept = jax.lax.while_loop(lambda s: s[0][4], body, (start, 0, kept))
        return listed.space, ((final[0], final[1], final[3]), kept)

    _, (results, kept) = jax.lax.scan(group, _space(groups, options, room), groups)
    return restore(results), kept


def _march_forward(table, lanes, lists, options, columns, room):
    out, kept = _forward(table, lanes, lists, options, columns, room)
    return out, (table, lanes, lists, out[0], out[1], kept)


def _march_backward(options, columns, room, saved, cotangent):
    table, lanes, lists, total, end, kept = saved
    g_channels, g_end, _ = cotangent
    groups, restore = _groups(lanes, lists, options)
    geometry = _geometry(table, columns, options)
    extra = _split({"total": total, "end": end, "g": g_channels, "g_end": g_end}, lists, options)

    def group(d_table, one):
        one, more, kept = one

        def shade_back(state, found):
            channels, transmittance, _, d_table, d_rays, _ = state
            index, last = found
            there = index >= 0
            rows = _components(table, index)
            (local, tau), pull = jax.vjp(
                lambda rows, lanes: _shade(rows, lanes, there, columns, options),
                rows,
                one["lanes"],
            )
            channels = channels + transmittance[None] * local
            rest = jnp.sum(more["g"] * (more["total"] - channels), axis=0)
            rest = rest + more["g_end"] * more["end"]
            live = tau > jnp.finfo(tau.dtype).tiny
            d_tau = jnp.where(live, rest / jnp.where(live, tau, 1), 0)
            d_rows, d_lanes = pull((transmittance[None] * more["g"], d_tau))
            d_rows = jnp.stack(d_rows, axis=-1)
            # Rays that are done and empty slots carry zeros, to the row of nothing.
            d_table = d_table.at[index.reshape(-1)].add(d_rows.reshape(-1, d_rows.shape[-1]))
            d_rays = jax.tree.map(jnp.add, d_rays, d_lanes)
            transmittance = transmittance * tau
            going = there[-1] & (transmittance > options.transmittance_min)
            after = jnp.where(going, last, _END[last.dtype])
            return channels, transmittance, after, d_table, d_rays, jnp.any(going)

        def kept_round(state):
            state, r = state
            return shade_back(state, jax.tree.map(lambda x: x[r], kept)), r + 1

        def further_rounds(state):
            space = _space(groups, options, room)
            listed = _list_keys(space, geometry, one, lists[0], options, columns)

            def body(state):
                found, _ = _round(listed, one, lists[0], state[2], options)
                return shade_back(state, found)

            return jax.lax.while_loop(lambda s: s[5], body, state)

        channels, transmittance, after, _, going = _start(one, table.dtype)
        zeros = jax.tree.map(jnp.zeros_like, one["lanes"])
        state = (channels, transmittance, after, d_table, zeros, going)
        rounds = _kept_rounds(options)
        state, _ = jax.lax.while_loop(lambda s: s[0][5] & (s[1] < rounds), kept_round, (state, 0))
        final = jax.lax.cond(state[5], further_rounds, lambda state: state, state)
        return final[3], final[4]

    d_table, d_rays = jax.lax.scan(group, jnp.zeros_like(table), (groups, extra, kept))
    return d_table, restore(d_rays), None


march = jax.custom_vjp(_march, nondiff_argnums=(3, 4, 5))
march.defvjp(_march_forward, _march_backward)

# Hits of a ray that are kept for the backward pass, a whole number of rounds; those beyond are
# found again.
_KEPT = 64
# Beyond this key nothing is left.
_END = {jnp.dtype("int32"): 2**31 - 1, jnp.dtype("int64"): 2**63 - 1}


def _kept_rounds(options):
    return max(_KEPT // options.k, 1)


def _start(one, dtype):
    rays = one["lanes"].origin.shape[1:]
    kind = jnp.int64 if dtype == jnp.float64 else jnp.int32
    return (
        jnp.zeros((4, *rays), dtype),
        jnp.ones(rays, dtype),
        jnp.full(rays, -1, kind),
        jnp.zeros(rays, jnp.int32),
        jnp.max(one["count"]) > 0,
    )


def _geometry(table, columns, options):
    """What finding hits needs: frame and mean at each key, opacity, and the squared reach."""
    state = table[:, : columns.opacity + 1]
    squared = reach(state[:, -1:], options.alpha_min) ** 2
    return jax.lax.stop_gradient(jnp.concatenate([state, squared], axis=1))


def _width(options) -> int:
    """How many bundles march together: on a CPU as many as its caches hold."""
    return options.group or (4 if jax.default_backend() == "cpu" else 16)


def _split(tree, lists, options):
    """Arrays (channels x bundles x rays) -> groups x channels x bundles of a group x rays."""
    order = jnp.argsort(lists[2])
    bundles = order.shape[0]
    width = _width(options)
    groups = -(-bundles // width)
    order = jnp.pad(order, (0, groups * width - bundles), constant_values=-1)

    def split(x):
        picked = jnp.where((order >= 0).reshape((1,) * (x.ndim - 2) + (-1, 1)), x[..., order, :], 0)
        parts = picked.reshape(*x.shape[:-2], groups, width, x.shape[-1])
        return jnp.moveaxis(parts, -3, 0)

    return jax.tree.map(split, tree)


def _groups(lanes, lists, options):
    """Bundles sorted by list length and cut into groups, and the way back."""
    _, start, count = lists
    order = jnp.argsort(count)
    bundles = order.shape[0]
    width = _width(options)
    groups = -(-bundles // width)
    padding = groups * width - bundles
    parts = {"lanes": _split(lanes, lists, options)}
    for name, x in (("start", start), ("count", count)):
        parts[name] = jnp.pad(x[order], (0, padding)).reshape(groups, width)
    parts["mask"] = slot_mask(parts["count"])[..., None]
    back = jnp.argsort(order)

    def restore(tree):
        def join(x):
            x = jnp.moveaxis(x, 0, -3)
            x = x.reshape(*x.shape[:-3], groups * width, x.shape[-1])
            return x[..., back, :]

        return jax.tree.map(join, tree)

    return parts, restore


class _Listed(NamedTuple):
    """Of every (list entry, ray) of a group, chunks x entries of a chunk x bundles x rays: the sort
    key, and distance and alpha of the hit. Only `chunks` of them are filled, as the longest list of
    the group wants. Evaluated once and kept for all rounds: to pick two numbers for a hit costs a
    CPU a third of what its response does, whose inputs lie apart."""

    key: Array
    t: Array
    alpha: Array
    chunks: Array

    @property
    def space(self):
        """The arrays, for the next group to write into."""
        return self.key, self.t, self.alpha


def _space(groups, options, room):
    """Arrays for what is listed of one group: made once, since to clear them takes as long as to
    fill them where lists are short."""
    origin = groups["lanes"].origin
    rays, dtype = origin.shape[2:], origin.dtype
    kind = jnp.int64 if dtype == jnp.float64 else jnp.int32
    shape = (-(-room // options.chunk), options.chunk, *rays)
    return tuple(jnp.zeros(shape, x) for x in (kind, dtype, dtype))


def _list_keys(space, geometry, one, index, options, columns) -> _Listed:
    lanes = jnp.arange(options.chunk, dtype=jnp.int32)
    rays = _with_entries(one["lanes"])
    kind, shape = space[0].dtype, space[0].shape

    def fill(i, kept):
        slot = i * options.chunk + lanes
        place = one["start"][None, :] + slot[:, None]
        rows = geometry[jnp.maximum(index.at[place].get(mode="clip"), 0)]
        row = [rows[..., i, None] for i in range(rows.shape[-1])]
        listed = slot[:, None] < one["count"][None, :]
        t, q = meet(row, rays, columns)
        met = listed[..., None] & (q < row[-1]) & (t > 0)
        alpha = opacity_on_ray(row[columns.opacity], q, alpha_max=options.alpha_max)
        order = jnp.where(met, jax.lax.bitcast_convert_type(t, kind), end)
        return jax.tree.map(lambda x, new: x.at[i].set(new), kept, (order, t, alpha))

    def widen(i, ends):
        low, high = ends
        order = orders[i]
        return jnp.minimum(low, order), jnp.maximum(high, jnp.where(order == end, 0, order))

    def finish(i, kept):
        slot = (i * options.chunk + lanes)[:, None, None]
        order = kept[i]
        key = sort_key(order, slot, low[None], high[None], one["mask"][None])
        return kept.at[i].set(jnp.where(order == end, end, key))

    chunks = -(-jnp.max(one["count"]) // options.chunk)
    end = _END[jnp.dtype(kind)]
    orders, t, alpha = jax.lax.fori_loop(0, chunks, fill, space)
    none = (jnp.full(shape[1:], end, kind), jnp.zeros(shape[1:], kind))
    low, high = jax.lax.fori_loop(0, chunks, widen, none)
    low, high = jnp.min(low, axis=0), jnp.max(high, axis=0)
    return _Listed(jax.lax.fori_loop(0, chunks, finish, orders), t, alpha, chunks)


def _round(listed, one, index, after, options):
    """The next k hits of every ray: Gaussian indices, -1 for none, and the last key; and the hits'
    slots in the lists."""
    kept = nearest_hits(listed.key, listed.chunks, after, k=options.k)
    there = kept != _END[kept.dtype]
    slot = jnp.where(there, kept & one["mask"].astype(kept.dtype)[None], 0).astype(jnp.int32)
    place = one["start"][None, :, None] + slot
    # The last row of the table is harmless: nothing that an empty slot shades can overflow.
    return (jnp.where(there, index.at[place].get(mode="clip"), -1), kept[-1]), slot


def _at_slots(listed, slot, there):
    """Distance and alpha of hits; both are 0 where there is none."""
    rays = jnp.arange(slot[0].size, dtype=jnp.int32).reshape(slot.shape[1:])
    place = slot * slot[0].size + rays[None]
    return (jnp.where(there, x.reshape(-1)[place], 0) for x in (listed.t, listed.alpha))


def _components(table, index):
    """Rows of the table for every hit, one array per column."""
    rows = table[index]
    return [rows[..., i] for i in range(table.shape[1])]


def _with_entries(lanes: Lanes) -> Lanes:
    """Rays with an axis for the entries that they meet."""
    return jax.tree.map(lambda x: x[:, None], lanes)


def _shade(rows, lanes, there, columns, options):
    """Channels and transmittance of one round of hits (columns of k x bundles x rays)."""
    t, q = meet(rows, _with_entries(lanes), columns)
    alpha = opacity_on_ray(rows[columns.opacity], q, alpha_max=options.alpha_max)
    alpha = jnp.where(there, alpha, 0)
    return _blended(rows[columns.opacity + 1 :], t, alpha, lanes, columns)


def _blended(paint, t, alpha, lanes, columns):
    """The same of hits whose distance and alpha are known; `paint` are the columns of colour."""
    lanes = _with_entries(lanes)
    harmonics = jnp.stack(paint[: 3 * columns.coefficients])
    harmonics = harmonics.reshape(-1, 3, *harmonics.shape[1:])
    color = radiance(harmonics, lanes.direction)
    if columns.tinted:
        color = color * tint_at(paint[3 * columns.coefficients :], lanes.weights)
    payload = jnp.concatenate([color, t[None]])
    return composite(alpha, t, payload)
