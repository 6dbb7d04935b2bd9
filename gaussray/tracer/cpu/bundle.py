"""The hits of a bundle of rays with the Gaussians of its list, in machine code for a CPU.

Every list entry meets all rays, in a loop that the compiler turns into vector instructions; then
the hits of each ray are sorted in short runs, of which the nearest comes first.
"""

from typing import Any, NamedTuple

import numpy as np
from numba.cpython.unsafe import numbers

from gaussray.runtime.machine_code import (
    allocating_code,
    flat_floats,
    floats,
    integers,
    machine_code,
    operand,
)
from gaussray.tracer.cpu.block import LANES
from gaussray.tracer.cpu.hit import Layout, harmonics_of
from gaussray.tracer.cpu.meet import (
    AT_Q,
    AT_T,
    BLENDED,
    fill_lanes,
    meet_lanes,
    met_lanes,
    new_lanes,
    respond_lanes,
)


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
    """Buffers of a thread for the hits of one bundle.

    Args:
        t: distance of every list entry on every ray, by blocks of `LANES` rays.
        alpha: opacity of every list entry where it peaks on every ray, before it is limited.
        hits: hits of every ray: the bits of the distance above those of the list entry.
        length: number of hits of every ray.
        spare: room for a run of hits.
        head: the nearest hit of each run that is still to come.
        place: where it is among the hits of the ray.
        lanes: rays side by side (`new_lanes`).
        blended: one Gaussian as each of these rays blends it.
        used: whether any of these rays has a weight of each key state.
        weights: weights of the control points of one ray.
        harmonics: harmonics of the direction of one ray.
    """

    t: Any
    alpha: Any
    hits: Any
    length: Any
    spare: Any
    head: Any
    place: Any
    lanes: Any
    blended: Any
    used: Any
    weights: Any
    harmonics: Any


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
    """Buffers for the hits of one bundle, long enough for the longest list."""
    blocks = (march.each + LANES - 1) // LANES
    return HitBuffers(
        np.empty((blocks, march.longest, LANES), np.float32),
        np.empty((blocks, march.longest, LANES), np.float32),
        np.empty((march.each, march.longest + _STEP), np.int64),
        np.empty(march.each, np.int64),
        np.empty(_RUN, np.int64),
        np.empty(march.longest // _RUN + 1, np.int64),
        np.empty(march.longest // _RUN + 1, np.int64),
        new_lanes(march.layout.keys),
        np.empty((BLENDED, LANES), np.float32),
        np.empty(march.layout.keys, np.bool_),
        np.empty(march.layout.keys, np.float32),
        np.empty(16, np.float32),
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
def find_hits(march, buffers, bundle):
    """Intersect the rays of a bundle with its list, and store the hits.

    Args:
        march: inputs of the march.
        buffers: the thread's buffers. `hits` (in the order of the list) and `length` are written,
            and of entries that a ray hits, `t` and `alpha`.
        bundle: index of the bundle.
    """
    first, last = list_range(march, bundle)
    lanes, used = buffers.lanes, buffers.used
    buffers.length[:] = 0
    for begin in range(0, march.each, LANES):
        count, i = min(LANES, march.each - begin), bundle * march.each + begin
        block = begin // LANES
        t, alpha, bits = buffers.t[block], buffers.alpha[block], buffers.t.view(np.uint32)[block]
        fill_lanes(lanes, used, march.layout, march.rays, i, count)
        for e in range(last - first):
            number = march.index[first + e]
            if number < 0:
                continue
            row = march.table[number]
            meet_lanes(lanes, used, buffers.blended, march.layout, row)
            met = met_lanes(lanes, march.squared[number])
            if met == np.uint64(0):
                continue
            respond_lanes(lanes, row[march.layout.opacity])
            for r in range(LANES):
                t[e, r], alpha[e, r] = lanes[AT_T + r], lanes[AT_Q + r]
            while met:
                lane = np.int64(_lowest_bit(met))
                met &= met - np.uint64(1)
                r = begin + lane
                buffers.hits[r, buffers.length[r]] = _hit(bits[e, lane], e)
                buffers.length[r] += 1


@machine_code
def _hit(bits, entry):
    """A hit as one number, nearer ones smaller; at the same distance, earlier entries."""
    return np.int64(bits) << 32 | np.int64(entry)


@machine_code
def _store_weights(march, buffers, i):
    """Store the weights of a ray."""
    for k in range(march.layout.keys):
        buffers.weights[k] = march.rays.weights[k, i]


# Hits of a run, and how many are compared at a time: what is behind the last hit does not count.
_RUN, _STEP = 64, 16
_NONE = np.int64(np.iinfo(np.int64).max)


@machine_code
def _sort_run(hits, spare, count):
    """Sort a run of hits, which others or `_STEP` of `_NONE` follow: each goes where as many are
    before it as are nearer. This compares more than other methods, but mispredicts no branch.
    """
    whole = (count + _STEP - 1) // _STEP * _STEP
    for i in range(count):
        hit, before = hits[i], 0
        for j in range(whole):
            before += hits[j] < hit
        spare[before] = hit
    for i in range(count):
        hits[i] = spare[i]


@machine_code
def begin_ray(march, buffers, bundle, r):
    """Prepare a ray: sort the runs of its hits, and store its weights and the harmonics of its
    direction.

    Args:
        march: inputs of the march.
        buffers: the thread's buffers, after `find_hits` of the bundle.
        bundle: index of the bundle.
        r: index of the ray within the bundle.

    Returns:
        The index of the ray among all rays.
    """
    i, hits, count = bundle * march.each + r, buffers.hits[r], buffers.length[r]
    for n in range(_STEP):
        hits[count + n] = _NONE
    for begin in range(0, count, _RUN):
        _sort_run(hits[begin:], buffers.spare, min(_RUN, count - begin))
        buffers.place[begin // _RUN], buffers.head[begin // _RUN] = begin, hits[begin]
    _store_weights(march, buffers, i)
    d = (march.rays.direction[0, i], march.rays.direction[1, i], march.rays.direction[2, i])
    harmonics_of(d, march.layout.coefficients, buffers.harmonics)
    return i


@machine_code
def pop_nearest(buffers, r):
    """The list entry of a ray's nearest hit that was not returned yet, counted from 0 in the list.

    Args:
        buffers: the thread's buffers, after `begin_ray`.
        r: index of the ray within the bundle; it has such a hit.
    """
    count, run = buffers.length[r], 0
    for k in range(1, (count + _RUN - 1) // _RUN):
        if buffers.head[k] < buffers.head[run]:
            run = k
    hit, place = buffers.head[run], buffers.place[run] + 1
    buffers.place[run] = place
    more = place < min(_RUN * (run + 1), count)
    buffers.head[run] = buffers.hits[r, place] if more else _NONE
    return hit & 0xFFFFFFFF
