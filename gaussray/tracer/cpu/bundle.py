"""The hits of a bundle of rays with the Gaussians of its list, in machine code for a CPU.

Block by block of its rays (cpu/block.py), every list entry meets all of them together; then the
hits of all are sorted together.
"""

from typing import Any, NamedTuple

import numpy as np
from numba.cpython.unsafe import numbers

from gaussray.runtime.machine_code import (
    allocating_code,
    flat_floats,
    floats,
    inlined_code,
    integers,
    machine_code,
    operand,
)
from gaussray.tracer.cpu.block import AT_T, LANES, begin_block, new_block
from gaussray.tracer.cpu.color import light_width, store_light
from gaussray.tracer.cpu.hit import Layout
from gaussray.tracer.cpu.meet import meet_lanes, met_lanes, store_alphas
from gaussray.tracer.cpu.sort import sort_lanes


_NO_DISTANCE = np.uint32(0x7FFFFFFF)
# An intrinsic, whose first parameter the compiler fills in.
_lowest_bit: Any = numbers.trailing_zeros


class RayArrays(NamedTuple):
    """Origins, directions, weights of the control points and times of all rays, components
    first."""

    origin: Any
    direction: Any
    weights: Any
    time: Any


class MarchInputs(NamedTuple):
    """Inputs of a march.

    Args:
        table: rows of the Gaussians (`table.gaussian_table`).
        squared: squared reach of each Gaussian, in standard deviations.
        rays: the rays of all bundles, one bundle after the other.
        index: Gaussians of all lists.
        start: start of each bundle's list.
        count: length of each bundle's list.
        layout: columns of the rows.
        each: rays of a bundle.
        longest: length of the longest list.
        alpha_max: largest alpha of a hit.
        transmittance_min: transmittance at which a ray ends.
        differentiates_rays: 1 if gradients of the rays are wanted, else 0.
    """

    table: Any
    squared: Any
    rays: RayArrays
    index: Any
    start: Any
    count: Any
    layout: Layout
    each: int
    longest: int
    alpha_max: float
    transmittance_min: float
    differentiates_rays: int


class HitBuffers(NamedTuple):
    """Buffers of a thread for the hits of one block of rays.

    Args:
        block: the rays (cpu/block.py).
        used: whether any of them has a weight of each key state.
        hits: hits of every ray: the bits of the distance above those of the list entry.
        length: number of hits of every ray.
        alpha: opacity of every list entry where it peaks on every ray, before it is limited; on the
            way back the gradient to its squared distance takes its place. Behind the last entry
            there is one that stands for none, here and in what follows.
        light: red of every list entry on every ray (`light_width`), then green, then blue.
        bits: the block as whole numbers.
    """

    block: Any
    used: Any
    hits: Any
    length: Any
    alpha: Any
    light: Any
    bits: Any


@allocating_code
def march_inputs(frame):
    """The inputs of a march, read from the operands of a call."""
    rays = RayArrays(
        floats(operand(frame, 2)),
        floats(operand(frame, 3)),
        floats(operand(frame, 4)),
        floats(operand(frame, 5)),
    )
    number, limit = integers(operand(frame, 9)), flat_floats(operand(frame, 10))
    layout = Layout(number[0], number[1], number[2], number[3], number[4], number[5])
    start, count = integers(operand(frame, 7)), integers(operand(frame, 8))
    longest = 0
    for b in range(len(count)):
        longest = max(longest, count[b])
    each = rays.origin.shape[1] // len(start)
    longest = min(longest, number[6])
    index = integers(operand(frame, 6))
    return MarchInputs(
        floats(operand(frame, 0)),
        flat_floats(operand(frame, 1)),
        rays,
        index,
        start,
        count,
        layout,
        each,
        longest,
        limit[0],
        limit[1],
        number[7],
    )


@allocating_code
def hit_buffers(march):
    """Buffers for the hits of one block, long enough for the longest list."""
    block = new_block(march.layout.keys)
    return HitBuffers(
        block,
        np.empty(march.layout.keys, np.bool_),
        np.empty((march.longest, LANES), np.int64),
        np.empty(LANES, np.int64),
        np.empty((march.longest + 1, LANES), np.float32),
        np.empty((march.longest + 1, 3 * light_width(march.layout)), np.float32),
        block.view(np.uint32),
    )


@machine_code
def list_range(march, bundle):
    """Begin and end (exclusive) of a bundle's list in `march.index`.

    Args:
        march: inputs of the march.
        bundle: index of the bundle.
    """
    first = march.start[bundle]
    last = min(first + min(march.count[bundle], march.longest), len(march.index))
    return first, last


@machine_code
def find_hits(march, buffers, bundle, begin):
    """Intersect the rays of a block with the list of their bundle, and sort their hits.

    Args:
        march: inputs of the march.
        buffers: the thread's buffers. `block`, `hits` (nearest first; at the same distance, as in
            the list; then `none_of`) and `length` are written, and of entries that a ray hits,
            `alpha` and `light`.
        bundle: index of the bundle.
        begin: index of the first ray of the block within the bundle.

    Returns:
        The largest number of hits of a ray.
    """
    first, last = list_range(march, bundle)
    block, layout = buffers.block, march.layout
    count, i = min(LANES, march.each - begin), bundle * march.each + begin
    begin_block(block, buffers.used, layout, march.rays, i, count)
    buffers.length[:] = 0
    for e in range(last - first):
        number = march.index[first + e]
        if number < 0:
            continue
        row = march.table[number]
        meet_lanes(block, buffers.used, layout, row)
        met = met_lanes(block, march.squared[number])
        if met == np.uint64(0):
            continue
        _add_hits(buffers, met, e)
        store_alphas(block, row[layout.opacity], buffers.alpha[e])
        store_light(row, layout, block, buffers.used, buffers.light[e])
    return _sort_hits(buffers, none_of(march))


@machine_code
def _add_hits(buffers, met, entry):
    """Append the hits of a list entry to those of the rays that it meets."""
    while met:
        r = np.int64(_lowest_bit(met))
        met &= met - np.uint64(1)
        buffers.hits[buffers.length[r], r] = _hit(buffers.bits[AT_T + r], entry)
        buffers.length[r] += 1


@inlined_code
def _hit(bits, entry):
    """A hit as one number, nearer ones smaller; at the same distance, earlier entries."""
    return np.int64(bits) << 32 | np.int64(entry)


@inlined_code
def none_of(march):
    """What stands for no hit: its distance, the largest bits, is not a number."""
    return _hit(_NO_DISTANCE, march.longest)


@machine_code
def _sort_hits(buffers, none):
    """Sort the hits of every ray, and return the largest number of hits of a ray."""
    hits, length, most = buffers.hits, buffers.length, 0
    for r in range(LANES):
        most = max(most, length[r])
    for n in range(most):
        for r in range(LANES):
            hits[n, r] = hits[n, r] if n < length[r] else none
    sort_lanes(hits, most)
    return most
