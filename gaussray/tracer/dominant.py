"""The Gaussian with the largest blending weight on each ray."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from gaussray.camera.rays import Rays, moved_to_start
from gaussray.tracer.bundle import split_into_bundles
from gaussray.tracer.k_nearest import nearest_hits, slot_mask, sort_key
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.prepare import Prepared
from gaussray.tracer.response import opacity_on_ray, reach_radius
from gaussray.tracer.table import Columns, Lanes, gaussian_table, ray_response, table_columns
from gaussray.tracer.trace import ray_lanes
from gaussray.tracer.traverse import Candidates


class Dominant(NamedTuple):
    """The Gaussian of the largest blending weight on every ray.

    Args:
        index: its index, in the order of `scene.at`; -1 if nothing is hit.
        weight: its blending weight.
        needed: list sizes, as in `trace.Report`.
        dropped: dropped entries, as in `trace.Report`.
    """

    index: Int[Array, " rays"]
    weight: Float[Array, " rays"]
    needed: Int[Array, " sizes"]
    dropped: Int[Array, ""]


class _Bundle(NamedTuple):
    """Rays of a bundle (components x 1 x rays) and its place in the list of candidates."""

    lanes: Lanes
    start: Int[Array, ""]
    count: Int[Array, ""]


def dominant(
    scene: Prepared, rays: Rays, lists: Candidates, *, options: TraceOptions, slots: int
) -> Dominant:
    """Find the largest blending weight alpha_i prod_{j before i} (1 - alpha_j) of every ray.

    Bundles march through their candidates as in the array backend, on any device and in any
    precision, k hits per round, until the transmittance of a ray is below the largest weight. Of
    equal weights the nearest hit counts. No gradient.

    Args:
        scene: prepared for trace.backend=array.
        rays: in a coherent order, as for `trace`.
        lists: the candidates of their bundles (`find_candidates`).
        options: how to trace.
        slots: the most candidates of a bundle.
    """
    count = rays.time.shape[0]
    layout = table_columns(scene.motion)
    rows = gaussian_table(scene.motion)[:, : layout.opacity + 1]
    lanes = ray_lanes(scene.motion, split_into_bundles(moved_to_start(rays), options))
    # Bundles come first, and a ray meets several Gaussians at once.
    lanes = jax.tree.map(lambda x: jnp.moveaxis(x, 1, 0)[:, :, None], lanes)
    walk = partial(_walk, rows, layout, lists.index, options=options, slots=slots)
    together = 4 if jax.default_backend() == "cpu" else 256
    bundles = _Bundle(lanes, lists.start, lists.count)
    index, weight = jax.lax.map(walk, bundles, batch_size=together)
    index, weight = index.reshape(-1)[:count], weight.reshape(-1)[:count]
    return Dominant(_scene_index(scene, index), weight, lists.needed, lists.dropped)


def _scene_index(scene: Prepared, index: Int[Array, " rays"]) -> Int[Array, " rays"]:
    """Indices among all Gaussians, of indices among those that are alive."""
    if scene.living is None:
        return index
    first, number = scene.motion.gaussians.count, scene.living.index
    place = jnp.clip(index - first, 0, number.shape[0] - 1)
    return jnp.where(index < first, index, first + number[place])


def _walk(rows, layout: Columns, index, bundle: _Bundle, *, options: TraceOptions, slots: int):
    """Index and weight of the dominant Gaussian of each ray of a bundle."""
    mask = slot_mask(bundle.count)
    dtype, rays = rows.dtype, bundle.lanes.origin.shape[-1]
    kind = jnp.int64 if dtype == jnp.float64 else jnp.int32
    end = jnp.iinfo(kind).max

    def met(gaussian: Int[Array, "hits _"]) -> tuple[Array, Array]:
        """Distance and alpha of Gaussians on the rays; alpha is 0 where they are not met."""
        weights = rows[gaussian]
        row = [weights[..., i] for i in range(weights.shape[-1])]
        t, q = ray_response(row, bundle.lanes, layout)
        opacity = jnp.broadcast_to(row[layout.opacity], q.shape)
        alpha = opacity_on_ray(opacity, q, alpha_max=options.alpha_max)
        return t, jnp.where((q < reach_radius(opacity, options.alpha_min) ** 2) & (t > 0), alpha, 0)

    lanes = jnp.arange(options.chunk, dtype=jnp.int32)
    chunks = -(-bundle.count // options.chunk)
    shape = (-(-slots // options.chunk), options.chunk, rays)

    def fill(i: Array, order: Array) -> Array:
        slot = i * options.chunk + lanes
        gaussian = jnp.maximum(index.at[bundle.start + slot].get(mode="clip"), 0)
        t, alpha = met(gaussian[:, None])
        there = (slot < bundle.count)[:, None] & (alpha > 0)
        return order.at[i].set(jnp.where(there, jax.lax.bitcast_convert_type(t, kind), end))

    order = jax.lax.fori_loop(0, chunks, fill, jnp.full(shape, end, kind))
    low = jnp.min(order, axis=(0, 1))
    high = jnp.max(jnp.where(order == end, 0, order), axis=(0, 1))
    slot = jnp.arange(shape[0] * shape[1], dtype=jnp.int32).reshape(*shape[:2], 1)
    key = sort_key(order, slot, low[None, None], high[None, None], mask)
    key = jnp.where(order == end, end, key)

    def round(state):
        best, weight, light, after, _ = state
        kept = nearest_hits(key, chunks, after, k=options.k)
        there = kept != end
        place = jnp.where(there, kept & mask.astype(kind), 0).astype(jnp.int32)
        gaussian = jnp.maximum(index.at[bundle.start + place].get(mode="clip"), 0)
        _, alpha = met(gaussian)
        alpha = jnp.where(there, alpha, 0)
        clear = jnp.log1p(-alpha)
        share = light[None] * alpha * jnp.exp(jnp.cumsum(clear, axis=0) - clear)
        top = jnp.argmax(share, axis=0)[None]
        weights = jnp.take_along_axis(share, top, axis=0)[0]
        better = weights > weight
        best = jnp.where(better, jnp.take_along_axis(gaussian, top, axis=0)[0], best)
        weight = jnp.where(better, weights, weight)
        light = light * jnp.prod(1 - alpha, axis=0)
        going = there[-1] & (light > jnp.maximum(weight, options.transmittance_min))
        return best, weight, light, jnp.where(going, kept[-1], end), jnp.any(going)

    none = jnp.full(rays, -1, jnp.int32), jnp.zeros(rays, dtype), jnp.ones(rays, dtype)
    state = (*none, jnp.full(rays, -1, kind), bundle.count > 0)
    return jax.lax.while_loop(lambda state: state[4], round, state)[:2]
