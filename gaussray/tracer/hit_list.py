"""The sorted hits of a group of bundles: distance and alpha of every list entry on every ray."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from gaussray.tracer.k_nearest import nearest_hits, sort_key
from gaussray.tracer.response import opacity_on_ray, reach_radius
from gaussray.tracer.table import Lanes, ray_response


# The sort key behind all hits.
LAST_KEY = {jnp.dtype("int32"): 2**31 - 1, jnp.dtype("int64"): 2**63 - 1}


def hit_geometry(table, columns, options):
    """Columns that determine hits: matrix and mean of each key state, time window, opacity; and
    the squared reach in standard deviations. No gradient.

    Args:
        table: rows of the Gaussians (`gaussian_table`).
        columns: columns of the table.
        options: options of the tracer; a Gaussian reaches to where its alpha is `alpha_min`.
    """
    state = table[:, : columns.opacity + 1]
    squared = reach_radius(state[:, -1:], options.alpha_min) ** 2
    return jax.lax.stop_gradient(jnp.concatenate([state, squared], axis=1))


class HitList(NamedTuple):
    """The hits of all list entries of a group with all rays, (chunks, entries of a chunk, bundles,
    rays).

    They are evaluated once and kept for all rounds: evaluating the response of a hit again costs a
    CPU three times as much as reading two numbers.

    Args:
        key: sort key, by distance and then by list entry; `LAST_KEY` where there is no hit.
        t: distance of the hit.
        alpha: alpha of the hit.
        chunks: number of chunks that are filled, after the longest list of the group.
    """

    key: Array
    t: Array
    alpha: Array
    chunks: Array

    @property
    def space(self):
        """The arrays, which the next group overwrites."""
        return self.key, self.t, self.alpha


def hit_list_buffers(groups, options, slots):
    """Buffers for the hits of one group.

    They are allocated once, because clearing them takes as long as filling them if lists are short.

    Args:
        groups: arrays of all groups (`bundle_groups`).
        options: options of the tracer.
        slots: length of the longest list.
    """
    origin = groups["lanes"].origin
    rays, dtype = origin.shape[2:], origin.dtype
    kind = jnp.int64 if dtype == jnp.float64 else jnp.int32
    shape = (-(-slots // options.chunk), options.chunk, *rays)
    return tuple(jnp.zeros(shape, x) for x in (kind, dtype, dtype))


def hit_list(space, geometry, one, index, options, columns) -> HitList:
    """Intersect the rays of a group with its lists.

    Args:
        space: arrays of `hit_list_buffers`, which are overwritten.
        geometry: columns of `hit_geometry`.
        one: arrays of the group (`bundle_groups`).
        index: the Gaussian of every list entry.
        options: options of the tracer.
        columns: columns of the table.
    """
    lanes = jnp.arange(options.chunk, dtype=jnp.int32)
    rays = with_entry_axis(one["lanes"])
    kind, shape = space[0].dtype, space[0].shape

    def fill(i, kept):
        slot = i * options.chunk + lanes
        place = one["start"][None, :] + slot[:, None]
        rows = geometry[jnp.maximum(index.at[place].get(mode="clip"), 0)]
        row = [rows[..., i, None] for i in range(rows.shape[-1])]
        in_list = slot[:, None] < one["count"][None, :]
        t, q = ray_response(row, rays, columns)
        met = in_list[..., None] & (q < row[-1]) & (t > 0)
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
    end = LAST_KEY[jnp.dtype(kind)]
    orders, t, alpha = jax.lax.fori_loop(0, chunks, fill, space)
    none = (jnp.full(shape[1:], end, kind), jnp.zeros(shape[1:], kind))
    low, high = jax.lax.fori_loop(0, chunks, widen, none)
    low, high = jnp.min(low, axis=0), jnp.max(high, axis=0)
    return HitList(jax.lax.fori_loop(0, chunks, finish, orders), t, alpha, chunks)


def next_hits(hit_table, one, index, after, options):
    """The k nearest hits of every ray behind the key `after`.

    Args:
        hit_table: hits of the group (`hit_list`).
        one: arrays of the group (`bundle_groups`).
        index: the Gaussian of every list entry.
        after: key of the last hit that was blended.
        options: options of the tracer.

    Returns:
        ((Gaussian indices, -1 where there is no hit; the last key), slots of the hits in the list).
    """
    kept = nearest_hits(hit_table.key, hit_table.chunks, after, k=options.k)
    there = kept != LAST_KEY[kept.dtype]
    slot = jnp.where(there, kept & one["mask"].astype(kept.dtype)[None], 0).astype(jnp.int32)
    place = one["start"][None, :, None] + slot
    # Index -1 reads the last row of the table, which is empty, so that nothing overflows.
    return (jnp.where(there, index.at[place].get(mode="clip"), -1), kept[-1]), slot


def hits_at(hit_table, slot, there):
    """Distance (scene units) and alpha of hits; 0 where there is none.

    Args:
        hit_table: hits of the group (`hit_list`).
        slot: place of each hit in the list of its bundle (`next_hits`), (hits, bundles, rays).
        there: whether there is a hit, in the same shape.
    """
    rays = jnp.arange(slot[0].size, dtype=jnp.int32).reshape(slot.shape[1:])
    place = slot * slot[0].size + rays[None]
    return (jnp.where(there, x.reshape(-1)[place], 0) for x in (hit_table.t, hit_table.alpha))


def with_entry_axis(lanes: Lanes) -> Lanes:
    """Rays with an axis for the entries that they meet."""
    return jax.tree.map(lambda x: x[:, None], lanes)
