"""Candidate lists: the Gaussians that each bundle of rays may hit.

Integers only: nothing here is differentiated.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaussray.tracer.alive_transients import Sweep
from gaussray.tracer.bundle import FAN, Bundles
from gaussray.tracer.grid import Fading, Grid


class Capacity(eqx.Module):
    """Static sizes of the lists of one trace, which `trace.measure` finds.

    Args:
        cells: largest number of (bundle, cell) pairs of each level, coarsest first. None at all:
            lists are found without a grid (cpu/lists.py; `options.grid_levels`).
        pairs: largest number of (bundle, Gaussian) pairs.
        slots: longest list of one bundle.
        transient: largest number of transient Gaussians that are alive during the rays' times.
    """

    cells: tuple[int, ...] = eqx.field(static=True)
    pairs: int = eqx.field(static=True)
    slots: int = eqx.field(static=True)
    transient: int = eqx.field(static=True, default=0)


def capacity_of_device(capacity: Capacity, devices: int) -> Capacity:
    """The list sizes of one of several devices that share the bundles of a picture: a quarter more
    than its share, because any one device may get the fullest.

    Args:
        capacity: the list sizes of all bundles.
        devices: how many devices share them.
    """

    def share(size: int) -> int:
        return max(-(-size * 5 // (4 * devices)), 64)

    cells = tuple(map(share, capacity.cells))
    return Capacity(cells, share(capacity.pairs), capacity.slots, capacity.transient)


def enlarged_size(present: int, wanted: int, *, headroom: float, near: float = 0.8) -> int:
    """A size of lists that leaves room. Rounded up to an eighth of a power of two, so that growth
    recompiles rarely.

    Args:
        present: the size so far; it stays while less than a share of it is needed.
        wanted: the needed size.
        headroom: factor of the needed size.
        near: that share.
    """
    if wanted <= near * present:
        return present
    target = max(int(wanted * headroom), 16)
    step = max(1 << (target.bit_length() - 3), 1)
    return -(-target // step) * step


class Candidates(eqx.Module):
    """The list of every bundle: `index[start : start + count]`.

    Args:
        index: the Gaussians of all lists.
        start: start of each bundle's list.
        count: length of each bundle's list.
        needed: sizes that this scene needs, in the order of `Capacity` (cells of each level, pairs,
            slots). Behind a size that overflowed they are lower bounds.
        dropped: number of entries that did not fit.
    """

    index: Int[Array, " pairs"]
    start: Int[Array, " bundles"]
    count: Int[Array, " bundles"]
    needed: Int[Array, " sizes"]
    dropped: Int[Array, ""]


def candidates(grid: Grid, levels: list[Bundles], *, capacity: Capacity) -> Candidates:
    """Find the candidate lists of all bundles, from coarse to fine.

    Each level tests the pairs that its parent level found.

    Pairs are tested in blocks, as many as there are pairs, so that unused capacity costs no time
    and a block's intermediate arrays stay small.

    Args:
        grid: the grid of Gaussians.
        levels: bundles from the coarsest level to the finest, FAN children per parent.
        capacity: sizes of the lists.
    """
    pairs, wanted = _coarse_pairs(grid, levels[0], capacity.cells[0])
    needed = [wanted]
    for bounds, size in zip(levels[1:], capacity.cells[1:], strict=True):
        pairs, wanted = _refine_pairs(grid, bounds, pairs, size)
        needed.append(wanted)
    return _gather_gaussians(grid, levels[-1], pairs, needed, capacity)


class _Pairs(NamedTuple):
    """(bundle, cell) pairs in the order of the bundles; the first `count` places are filled."""

    bundle: Int[Array, " places"]
    cell: Int[Array, " places"]
    count: Int[Array, ""]

    def block(self, first: Int[Array, ""], size: int) -> tuple[Array, Array, Array]:
        """Bundles and cells of `size` places from `first` on, and which of them are filled."""
        one, other = (
            jax.lax.dynamic_slice_in_dim(x, first, size) for x in (self.bundle, self.cell)
        )
        return one, other, first + jnp.arange(size, dtype=jnp.int32) < self.count


def _coarse_pairs(grid: Grid, bounds: Bundles, size: int) -> tuple[_Pairs, Int[Array, ""]]:
    """Test all bundles of a level against all cells, a few bundles at a time.

    Returns:
        The pairs that fit, and the number of all pairs.
    """
    bundles, cells = bounds.offset.shape[0], grid.lower.shape[0]
    rows = min(max(_block_size() // cells, 1), bundles)
    filled = grid.lower[:, 0] <= grid.upper[:, 0]
    cell = jnp.broadcast_to(jnp.arange(cells, dtype=jnp.int32), (rows, cells))

    def step(first: Array, state: tuple[_Pairs, Array]) -> tuple[_Pairs, Array]:
        # The last block may overlap the one before it; overlapping rows do not count again.
        begin = jnp.minimum(first, bundles - rows)
        bundle = begin + jnp.arange(rows, dtype=jnp.int32)
        bounded = jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, begin, rows), bounds)
        touched = jax.vmap(lambda b: _touches_box(b, grid.lower, grid.upper))(bounded)
        touched = touched & filled[None] & (bundle >= first)[:, None]
        return _append_pairs(
            state, touched, jnp.broadcast_to(bundle[:, None], cell.shape), cell, size
        )

    start = _empty_pairs(size), jnp.zeros((), jnp.int32)
    return _blocks(bundles, rows, step, start)


def _refine_pairs(
    grid: Grid, bounds: Bundles, pairs: _Pairs, size: int
) -> tuple[_Pairs, Int[Array, ""]]:
    """(parent, cell) pairs -> (child, cell) pairs, ordered by child without sorting.

    The first pass finds the children of each pair, as bits, and the number of pairs of each child.
    The second pass writes every pair to the next place of its child.
    """
    block, bundles = min(_block_size(), pairs.cell.shape[0]), bounds.offset.shape[0]
    fan = jnp.arange(FAN, dtype=jnp.int32)

    def ask(first: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        bits, count = state
        parent, cell, filled = pairs.block(first, block)
        child = jax.tree.map(lambda x: x.reshape(-1, FAN, *x.shape[1:])[parent], bounds)
        touched = _touches_box(child, grid.lower[cell][:, None], grid.upper[cell][:, None])
        touched = touched & filled[:, None]
        bits_of_pairs = jnp.sum(touched << fan[None], axis=1, dtype=jnp.int32)
        return (
            jax.lax.dynamic_update_slice_in_dim(bits, bits_of_pairs, first, 0),
            count.at[parent].add(touched.astype(jnp.int32)),
        )

    none = jnp.zeros_like(pairs.cell), jnp.zeros((bundles // FAN, FAN), jnp.int32)
    bits, count = _blocks(pairs.count, block, ask, none)
    ends = jnp.cumsum(count.reshape(-1), dtype=jnp.int32)

    def put(first: Array, state: tuple[_Pairs, Array]) -> tuple[_Pairs, Array]:
        kept, following = state
        parent, cell, _ = pairs.block(first, block)
        bits_of_pairs = jax.lax.dynamic_slice_in_dim(bits, first, block)
        touched = (bits_of_pairs[:, None] >> fan[None]) & 1
        # Number of pairs before it in this block, without those of other parents.
        before = jnp.cumsum(touched, axis=0, dtype=jnp.int32) - touched
        opens = jnp.concatenate([jnp.ones(1, bool), parent[1:] != parent[:-1]])
        opening = jax.lax.cummax(jnp.where(opens, jnp.arange(block), 0))
        place = following[parent] + before - before[opening]
        place = jnp.where((touched > 0) & (place < size), place, kept.cell.shape[0])
        child = parent[:, None] * FAN + fan[None]
        return (
            _write_pairs(kept, place, child, jnp.broadcast_to(cell[:, None], child.shape)),
            following.at[parent].add(touched),
        )

    start = _empty_pairs(size), ends.reshape(count.shape) - count
    kept, _ = _blocks(pairs.count, block, put, start)
    return kept._replace(count=jnp.minimum(ends[-1], size)), ends[-1]


def _gather_gaussians(
    grid: Grid, bounds: Bundles, pairs: _Pairs, needed: list[Array], capacity: Capacity
) -> Candidates:
    """(bundle, cell) pairs -> the list of Gaussians of every bundle."""
    block, bundles = min(_block_size(), pairs.cell.shape[0]), bounds.offset.shape[0]
    # Components first, Gaussians last, so that the Gaussians of a cell are contiguous.
    center = jnp.moveaxis(grid.center, (1, 3, 0), (0, 1, 2))
    axes = jnp.moveaxis(grid.axes, (1, 3, 4, 0), (0, 1, 2, 3))
    fading = grid.fading

    def step(first: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        index, count, total = state
        bundle, cell, filled = pairs.block(first, block)
        side = jax.tree.map(lambda x: x[bundle], bounds)
        index_of_cell = grid.index[cell]
        swept = None if fading is None else _cell_sweep(fading, cell, side)
        mask = _touches_ellipsoid(side, center[cell], axes[cell], swept)
        mask = mask & filled[:, None] & (index_of_cell >= 0)
        rank = jnp.cumsum(mask.reshape(-1), dtype=jnp.int32)
        place = jnp.where(mask.reshape(-1), total + rank - 1, capacity.pairs)
        return (
            index.at[place].set(index_of_cell.reshape(-1), mode="drop"),
            count.at[bundle].add(jnp.sum(mask, axis=1, dtype=jnp.int32)),
            total + rank[-1],
        )

    none = jnp.full(capacity.pairs, -1, jnp.int32), jnp.zeros(bundles, jnp.int32)
    index, count, total = _blocks(pairs.count, block, step, (*none, jnp.zeros((), jnp.int32)))
    start = jnp.cumsum(count, dtype=jnp.int32) - count
    sizes = jnp.stack([*needed, total, jnp.max(count)])
    room = jnp.asarray([*capacity.cells, capacity.pairs], jnp.int32)
    there = jnp.clip(capacity.pairs - start, 0, count)
    fits = jnp.minimum(there, capacity.slots)
    lost = jnp.sum(jnp.maximum(sizes[:-1] - room, 0)) + jnp.sum(there - fits)
    return Candidates(index, start, fits, sizes, lost.astype(jnp.int32))


def _block_size() -> int:
    """Number of pairs in a block: on a CPU as many as its caches hold."""
    return 1 << (11 if jax.default_backend() == "cpu" else 18)


def _blocks(count: int | Int[Array, ""], size: int, step: Callable, state):
    """Run `step` on every block of `size` places, up to `count`, and return the last state."""
    blocks = -(-count // size)
    return jax.lax.fori_loop(0, blocks, lambda i, state: step(i * size, state), state)


def _empty_pairs(size: int) -> _Pairs:
    """Empty pairs with room for `size`, in whole blocks."""
    block = min(_block_size(), size)
    nothing = jnp.zeros(-(-size // block) * block, jnp.int32)
    return _Pairs(nothing, nothing, jnp.zeros((), jnp.int32))


def _append_pairs(
    state: tuple[_Pairs, Array], mask: Array, bundle: Array, cell: Array, size: int
) -> tuple[_Pairs, Array]:
    """Append the pairs under the mask, in order, as far as they fit; also the number of all."""
    kept, total = state
    rank = total + jnp.cumsum(mask.reshape(-1), dtype=jnp.int32)
    place = jnp.where(mask.reshape(-1) & (rank <= size), rank - 1, kept.cell.shape[0])
    kept = _write_pairs(kept, place, bundle.reshape(-1), cell.reshape(-1))
    return kept._replace(count=jnp.minimum(rank[-1], size)), rank[-1]


def _write_pairs(pairs: _Pairs, place: Array, bundle: Array, cell: Array) -> _Pairs:
    """Write pairs to their places; places beyond the last are dropped."""
    return pairs._replace(
        bundle=pairs.bundle.at[place].set(bundle, mode="drop"),
        cell=pairs.cell.at[place].set(cell, mode="drop"),
    )


def _touches_box(
    bundle: Bundles, lower: Float[Array, "*boxes 3"], upper: Float[Array, "*boxes 3"]
) -> Bool[Array, "*both"]:
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


def _cell_sweep(fading: Fading, cell: Int[Array, " pairs"], bundle: Bundles) -> Sweep:
    """Motion and fading of the Gaussians of a cell during the time of its bundle."""
    of_cell = Fading(
        jax.tree.map(lambda x: x[cell], fading.window), fading.radius[cell], fading.time_range
    )
    return of_cell.between(bundle.earliest[:, None], bundle.latest[:, None])


def _touches_ellipsoid(
    bundle: Bundles,
    center: Float[Array, "pairs 3 keys occupancy"],
    axes: Float[Array, "pairs 3 3 keys occupancy"],
    swept: Sweep | None,
) -> Bool[Array, "pairs occupancy"]:
    """False where the ellipsoid lies outside one half-space of its bundle at all active control
    points, or where it is not alive in the bundle's time.

    Its support along n is n.c + |F^T n|. The maximum over the control points bounds every time of
    the bundle's window (see `motion.Motion`). A transient one moves on a line, so the largest
    support is that at one of its ends, with the largest ellipsoid.
    """
    inside = jnp.array(True) if swept is None else swept.shrink > 0
    for i in range(5):
        n = bundle.normal[:, i, :, None, None]
        along = sum(n[:, a] * center[:, a] for a in range(3))
        squared = 0
        for b in range(3):
            part = sum(n[:, a] * axes[:, a, b] for a in range(3))
            squared = squared + part * part
        height = jnp.sqrt(squared)
        if swept is not None:
            shift = jnp.maximum(
                *(sum(n[:, a, 0] * x[..., a] for a in range(3)) for x in (swept.first, swept.last))
            )
            along, height = along + shift[:, None], height * swept.shrink[:, None]
        support = jnp.where(bundle.active[..., None], along + height, -jnp.inf)
        side = jnp.max(support, axis=1) >= bundle.offset[:, i, None]
        inside = inside & side
    return inside
