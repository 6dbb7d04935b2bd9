"""Which Gaussians a bundle of rays can meet, and which of them come next along each ray.

Integers only: nothing here is differentiated.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaussray.tracer.bundle import FAN, Bundles
from gaussray.tracer.grid import Grid


# Pairs that are tested at once: what a test looks up takes many times the room of its answer.
_AT_ONCE = 1 << 18


class Capacity(eqx.Module):
    """Static sizes of the lists of one trace, from the coarsest level to the finest.

    `cells[i]` bounds the (bundle, cell) pairs of level i, `pairs` the (bundle, Gaussian) pairs and
    `slots` the longest list of one bundle. Measured with head-room by `trace.measure`.
    """

    cells: tuple[int, ...] = eqx.field(static=True)
    pairs: int = eqx.field(static=True)
    slots: int = eqx.field(static=True)


class Candidates(eqx.Module):
    """For every bundle the Gaussians it may meet: `index[start : start + count]`.

    `needed` holds the sizes that this scene wants, in the order of `Capacity` (cells of each level,
    pairs, slots); a size below another that overflowed is a lower bound. `dropped` counts the
    entries that did not fit.
    """

    index: Int[Array, " pairs"]
    start: Int[Array, " bundles"]
    count: Int[Array, " bundles"]
    needed: Int[Array, " sizes"]
    dropped: Int[Array, ""]


def candidates(grid: Grid, levels: list[Bundles], *, capacity: Capacity) -> Candidates:
    """Bundles against grid, coarse to fine: every level tests only what its parent kept.

    `levels` runs from the coarsest bundles to the finest, FAN children to each parent.
    """
    coarse = levels[0]
    bundles, cells = coarse.offset.shape[0], grid.lower.shape[0]
    touched = jax.vmap(lambda b: _touches_box(b, grid.lower, grid.upper))(coarse)
    touched = touched & (grid.lower[:, 0] <= grid.upper[:, 0])[None, :]
    bundle = jnp.repeat(jnp.arange(bundles, dtype=jnp.int32), cells)
    cell = jnp.tile(jnp.arange(cells, dtype=jnp.int32), bundles)
    pair, wanted = _keep(touched.reshape(-1), capacity.cells[0], bundle, cell)
    needed = [wanted]
    for bounds, size in zip(levels[1:], capacity.cells[1:], strict=True):
        pair, wanted = _refine(grid, bounds, pair, size)
        needed.append(wanted)
    return _gather(grid, levels[-1], pair, needed, capacity)


def _keep(mask: Array, size: int, *values: Array) -> tuple[list[Array], Array]:
    """The entries under the mask, in order, in `size` places; places left over hold -1."""
    rank = jnp.cumsum(mask, dtype=jnp.int32)
    place = jnp.where(mask, rank - 1, size)
    kept = [jnp.full(size, -1, jnp.int32).at[place].set(v, mode="drop") for v in values]
    return kept, rank[-1]


def _refine(grid: Grid, bounds: Bundles, pair: list[Array], size: int) -> tuple[list[Array], Array]:
    """(parent, cell) pairs -> (child, cell) pairs, ordered by child without sorting.

    A child's place is the start of its run, known from counts, plus its rank among the pairs of its
    parent, known from a running sum.
    """
    parent, cell = pair
    real = parent >= 0
    fan = jnp.arange(FAN, dtype=jnp.int32)

    def touched(parent: Array, cell: Array) -> Array:
        lower, upper = (x[jnp.maximum(cell, 0)] for x in (grid.lower, grid.upper))
        child = jnp.maximum(parent, 0)[:, None] * FAN + fan[None]
        bundle = jax.tree.map(lambda x: x[child], bounds)
        return jax.vmap(jax.vmap(_touches_box, in_axes=(0, None, None)))(bundle, lower, upper)

    child = jnp.maximum(parent, 0)[:, None] * FAN + fan[None]
    mask = _in_blocks(touched, parent, cell) & real[:, None]
    running = jnp.concatenate([jnp.zeros((1, FAN), jnp.int32), jnp.cumsum(mask, 0, jnp.int32)])
    parents = bounds.offset.shape[0] // FAN
    total = jnp.sum(real, dtype=jnp.int32)
    edge = jnp.searchsorted(jnp.where(real, parent, parents), jnp.arange(parents + 1))
    edge = jnp.minimum(edge.astype(jnp.int32), total)
    at_edge = running[edge]
    count = (at_edge[1:] - at_edge[:-1]).reshape(-1)
    start = jnp.cumsum(count, dtype=jnp.int32) - count
    rank = running[:-1] - at_edge[jnp.maximum(parent, 0)]
    place = jnp.where(mask, start[child] + rank, size).reshape(-1)
    kept = [
        jnp.full(size, -1, jnp.int32).at[place].set(v.reshape(-1), mode="drop")
        for v in (child, jnp.broadcast_to(cell[:, None], child.shape))
    ]
    return kept, jnp.sum(count, dtype=jnp.int32)


def _gather(
    grid: Grid, bounds: Bundles, pair: list[Array], needed: list[Array], capacity: Capacity
) -> Candidates:
    """(bundle, cell) pairs -> the list of Gaussians of every bundle."""
    bundle, cell = pair
    test = jax.vmap(_touches_ellipsoid, in_axes=(None, 0, 0))
    center, axes = (jnp.moveaxis(x, 0, 2) for x in (grid.center, grid.axes))

    def touched(bundle: Array, cell: Array) -> Array:
        place = jnp.maximum(cell, 0)
        side = jax.tree.map(lambda x: x[jnp.maximum(bundle, 0)], bounds)
        return jax.vmap(test)(side, center[place], axes[place])

    index = grid.index[jnp.maximum(cell, 0)]
    mask = _in_blocks(touched, bundle, cell) & (bundle >= 0)[:, None] & (index >= 0)
    (index,), pairs = _keep(mask.reshape(-1), capacity.pairs, index.reshape(-1))
    bundles = bounds.offset.shape[0]
    total = jnp.pad(jnp.cumsum(jnp.sum(mask, 1, dtype=jnp.int32), dtype=jnp.int32), (1, 0))
    edge = jnp.searchsorted(jnp.where(bundle >= 0, bundle, bundles), jnp.arange(bundles + 1))
    edge = total[edge]
    start, count = edge[:-1], edge[1:] - edge[:-1]
    longest = jnp.max(count)
    sizes = jnp.stack([*needed, pairs, longest])
    held = jnp.asarray([*capacity.cells, capacity.pairs], jnp.int32)
    there = jnp.clip(capacity.pairs - start, 0, count)
    fits = jnp.minimum(there, capacity.slots)
    lost = jnp.sum(jnp.maximum(sizes[:-1] - held, 0)) + jnp.sum(there - fits)
    return Candidates(index, start, fits, sizes, lost.astype(jnp.int32))


def _in_blocks(
    test: Callable[[Array, Array], Array], first: Int[Array, " pairs"], second: Int[Array, " pairs"]
) -> Bool[Array, "pairs each"]:
    """A test of pairs, of many one block after another."""
    size = first.shape[0]
    if size <= _AT_ONCE:
        return test(first, second)

    def cut(x: Array) -> Array:
        return jnp.pad(x, (0, -size % _AT_ONCE)).reshape(-1, _AT_ONCE)

    found = jax.lax.map(lambda pair: test(*pair), (cut(first), cut(second)))
    return found.reshape(-1, found.shape[-1])[:size]


def _touches_box(bundle: Bundles, lower: Array, upper: Array) -> Bool[Array, "*batch"]:
    """False where the box lies outside one of the bundle's half-spaces."""
    inside = jnp.array(True)
    for i in range(5):
        n = bundle.normal[..., i, :]
        farthest = sum(
            jnp.maximum(n[..., a] * lower[..., a], n[..., a] * upper[..., a]) for a in range(3)
        )
        side = farthest >= bundle.offset[..., i]
        inside = inside & side
    return inside


def _touches_ellipsoid(
    bundle: Bundles, center: Float[Array, "keys 3"], axes: Float[Array, "keys 3 3"]
) -> Bool[Array, ""]:
    """False where the ellipsoid lies outside one half-space at all active control points.

    Its support along n is n.c + |F^T n|. The maximum over the control points bounds every time of
    the bundle's window (see `motion.Motion`).
    """
    inside = jnp.array(True)
    for i in range(5):
        n = bundle.normal[i]
        along = sum(n[a] * center[:, a] for a in range(3))
        squared = 0
        for b in range(3):
            part = sum(n[a] * axes[:, a, b] for a in range(3))
            squared = squared + part * part
        support = jnp.where(bundle.active, along + jnp.sqrt(squared), -jnp.inf)
        side = jnp.max(support) >= bundle.offset[i]
        inside = inside & side
    return inside


def nearest(
    keys: Int[Array, "chunks chunk *rays"],
    chunks: Int[Array, ""],
    after: Int[Array, "*rays"],
    *,
    k: int,
) -> Int[Array, " k *rays"]:
    """The k smallest keys beyond `after` on every ray, smallest first; none left = the largest int.

    The first `chunks` chunks of the keys are inserted one by one:
    kb[i] <- min(max(x, kb[i-1]), kb[i]), two integer operations a slot.
    """
    none = jnp.iinfo(after.dtype).max
    lowest = jnp.full((1, *after.shape), jnp.iinfo(after.dtype).min, after.dtype)

    def insert(kept: Array, key: Array) -> tuple[Array, None]:
        shifted = jnp.concatenate([lowest, kept[:-1]])
        return jnp.minimum(jnp.maximum(key[None], shifted), kept), None

    def chunk(i: Array, kept: Array) -> Array:
        some = jax.lax.dynamic_index_in_dim(keys, i, keepdims=False)
        return jax.lax.scan(insert, kept, jnp.where(some > after[None], some, none))[0]

    return jax.lax.fori_loop(0, chunks, chunk, jnp.full((k, *after.shape), none, after.dtype))


def slot_mask(count: Int[Array, "*lists"]) -> Int[Array, "*lists"]:
    """The low bits that tell the slots of so many entries apart.

    From the list itself, not from the room that there is for it: what rays see must not depend on
    which frame or step the room was measured with.
    """
    most = jnp.maximum(count - 1, 1)
    # The position of the highest bit, twice that, and all bits below.
    return (2 << (jnp.iinfo(most.dtype).bits - 1 - jax.lax.clz(most))) - 1


def pack(
    order: Int[Array, "*hits"],
    slot: Int[Array, "*slots"],
    low: Int[Array, "*rays"],
    high: Int[Array, "*rays"],
    mask: Int[Array, "*lists"],
) -> Int[Array, "*hits"]:
    """One integer that sorts by distance and remembers the slot in the low bits of the `mask`.

    `order` holds the float bits of t > 0, which sort as t does, between `low` and `high` on this
    ray. Their difference is stretched over all the bits there are before the low ones are given to
    the slot, so distances are told apart to about (high - low) mask 2^-29 in float32, however
    far away they lie. Closer ones are ordered by slot; shading restores their exact order within a
    round.
    """
    # Two bits stay free: the sign, and one that keeps every key below the largest integer.
    shift = jnp.maximum(jax.lax.clz(jnp.maximum(high - low, 0)) - 2, 0)
    # The bounds may be compiled apart from the distances, and differ by their rounding.
    above = jnp.clip(order, low, high) - low
    return ((above << shift) & ~mask.astype(order.dtype)) | slot.astype(order.dtype)
