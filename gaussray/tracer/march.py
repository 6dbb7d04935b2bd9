"""Marches ray bundles through their lists: the nearest hits, round by round, are blended."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

from gaussray.scene.harmonics import radiance
from gaussray.tracer.bundle_groups import bundle_groups, split_into_groups
from gaussray.tracer.composite import composite
from gaussray.tracer.hit_list import (
    LAST_KEY,
    hit_geometry,
    hit_list,
    hit_list_buffers,
    hits_at,
    next_hits,
    with_entry_axis,
)
from gaussray.tracer.response import opacity_on_ray
from gaussray.tracer.table import ray_response, tint_at


def _march(table, lanes, lists, options, columns, slots) -> tuple[Array, Array, Array]:
    """Channels (red, green, blue, depth), transmittance and number of hits of every ray.

    Bundles march in groups of similar list length. The gradient is custom, because the number of
    rounds is only known at run time, and because only the result and the nearest `_STORED` hits of
    a ray are stored, which mostly are all. The backward pass repeats the rounds, front to back.
    Round r contributes T_r L_r to the sum, and T_{r+1} = T_r tau_r. Hence dL_r = T_r g and
    dtau_r = (g . (total - sum up to r) + g_T T_end) / tau_r. JAX differentiates the shading.
    """
    return _forward(table, lanes, lists, options, columns, slots)[0]


def _forward(table, lanes, lists, options, columns, slots):
    groups, restore = bundle_groups(lanes, lists, options)
    geometry, paint = hit_geometry(table, columns, options), table[:, columns.opacity + 1 :]

    def group(space, one):
        hit_table = hit_list(space, geometry, one, lists[0], options, columns)

        def body(state):
            (channels, transmittance, after, hits, _), r, stored = state
            nearest, slot = next_hits(hit_table, one, lists[0], after, options)
            index, last = nearest
            there = index >= 0
            t, alpha = hits_at(hit_table, slot, there)
            rows = _components(paint, index)
            local, tau = _blend_hits(rows, t, alpha, one["lanes"], columns)
            channels = channels + transmittance[None] * local
            transmittance = transmittance * tau
            active = there[-1] & (transmittance > options.transmittance_min)
            after = jnp.where(active, last, LAST_KEY[last.dtype])
            stored = jax.tree.map(lambda x, new: x.at[r].set(new, mode="drop"), stored, nearest)
            hits = hits + jnp.sum(there, axis=0, dtype=jnp.int32)
            return (channels, transmittance, after, hits, jnp.any(active)), r + 1, stored

        start = _start(one, table.dtype)
        rounds, after = _stored_rounds(options), start[2]
        stored = (
            jnp.full((rounds, options.k, *after.shape), -1, jnp.int32),
            jnp.zeros((rounds, *after.shape), after.dtype),
        )
        final, _, stored = jax.lax.while_loop(lambda s: s[0][4], body, (start, 0, stored))
        return hit_table.space, ((final[0], final[1], final[3]), stored)

    _, (results, stored) = jax.lax.scan(group, hit_list_buffers(groups, options, slots), groups)
    return restore(results), stored


def _march_forward(table, lanes, lists, options, columns, slots):
    out, stored = _forward(table, lanes, lists, options, columns, slots)
    return out, (table, lanes, lists, out[0], out[1], stored)


def _march_backward(options, columns, slots, saved, cotangent):
    table, lanes, lists, total, end, stored = saved
    g_channels, g_end, _ = cotangent
    groups, restore = bundle_groups(lanes, lists, options)
    geometry = hit_geometry(table, columns, options)
    extra = split_into_groups(
        {"total": total, "end": end, "g": g_channels, "g_end": g_end}, lists, options
    )

    def group(d_table, one):
        one, more, stored = one

        def shade_backward(state, nearest):
            channels, transmittance, _, d_table, d_rays, _ = state
            index, last = nearest
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
            # Finished rays and empty slots add zeros to the empty last row.
            d_table = d_table.at[index.reshape(-1)].add(d_rows.reshape(-1, d_rows.shape[-1]))
            d_rays = jax.tree.map(jnp.add, d_rays, d_lanes)
            transmittance = transmittance * tau
            active = there[-1] & (transmittance > options.transmittance_min)
            after = jnp.where(active, last, LAST_KEY[last.dtype])
            return channels, transmittance, after, d_table, d_rays, jnp.any(active)

        def stored_round(state):
            state, r = state
            return shade_backward(state, jax.tree.map(lambda x: x[r], stored)), r + 1

        def searched_rounds(state):
            space = hit_list_buffers(groups, options, slots)
            hit_table = hit_list(space, geometry, one, lists[0], options, columns)

            def body(state):
                nearest, _ = next_hits(hit_table, one, lists[0], state[2], options)
                return shade_backward(state, nearest)

            return jax.lax.while_loop(lambda s: s[5], body, state)

        channels, transmittance, after, _, active = _start(one, table.dtype)
        zeros = jax.tree.map(jnp.zeros_like, one["lanes"])
        state = (channels, transmittance, after, d_table, zeros, active)
        rounds = _stored_rounds(options)
        state, _ = jax.lax.while_loop(lambda s: s[0][5] & (s[1] < rounds), stored_round, (state, 0))
        final = jax.lax.cond(state[5], searched_rounds, lambda state: state, state)
        return final[3], final[4]

    d_table, d_rays = jax.lax.scan(group, jnp.zeros_like(table), (groups, extra, stored))
    return d_table, restore(d_rays), None


march = jax.custom_vjp(_march, nondiff_argnums=(3, 4, 5))
march.defvjp(_march_forward, _march_backward)

# Hits of a ray that are stored for the backward pass, in whole rounds; further ones are searched
# again.
_STORED = 64


def _stored_rounds(options):
    return max(_STORED // options.k, 1)


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


def _components(table, index):
    """The rows of the table of every hit, as one array per column."""
    rows = table[index]
    return [rows[..., i] for i in range(table.shape[1])]


def _shade(rows, lanes, there, columns, options):
    """Channels and transmittance of one round of hits; `rows` are columns (k, bundles, rays)."""
    t, q = ray_response(rows, with_entry_axis(lanes), columns)
    alpha = opacity_on_ray(rows[columns.opacity], q, alpha_max=options.alpha_max)
    alpha = jnp.where(there, alpha, 0)
    return _blend_hits(rows[columns.opacity + 1 :], t, alpha, lanes, columns)


def _blend_hits(paint, t, alpha, lanes, columns):
    """Channels and transmittance of hits whose distance and alpha are known; `paint` holds the
    columns of colour."""
    lanes = with_entry_axis(lanes)
    harmonics = jnp.stack(paint[: 3 * columns.coefficients])
    harmonics = harmonics.reshape(-1, 3, *harmonics.shape[1:])
    color = radiance(harmonics, lanes.direction)
    if columns.tinted:
        color = color * tint_at(paint[3 * columns.coefficients :], lanes.weights)
    payload = jnp.concatenate([color, t[None]])
    return composite(alpha, t, payload)
