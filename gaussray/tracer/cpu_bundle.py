"""The hits of a bundle of rays with the Gaussians of its list, in machine code for a CPU.

Every list entry meets all rays, in a loop that the compiler turns into vector instructions; each
ray keeps its hits in a heap, the nearest first.
"""

from typing import Any, NamedTuple

import numpy as np

from gaussray.tracer.cpu_call import flat_floats, floats, integers, machine_code, operand
from gaussray.tracer.cpu_hit import Layout, flank, harmonics_of, inverse_of, meet_ray, nine


_ZERO = np.float32(0)


class RayArrays(NamedTuple):
    """Origins, directions, weights of the control points and times of all rays, components
    first."""

    origin: Any
    direction: Any
    weights: Any
    time: Any


class March(NamedTuple):
    """What a march reads: the rows, their squared reaches, the rays of all bundles in turn, lists
    (Gaussians; first place and length of every bundle's), layout, rays of a bundle, the longest
    list, the largest alpha, and the transmittance at which a ray ends."""

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


class Room(NamedTuple):
    """Where a thread notes the hits of a bundle: distance and squared distance of every entry on
    every ray, the heap of every ray and its length; matrix and mean of one entry, blended for
    every ray, and which key states any ray has a weight of; of one ray the weights and the
    harmonics of its direction."""

    t: Any
    q: Any
    heap: Any
    length: Any
    blended: Any
    used: Any
    weights: Any
    harmonics: Any


@machine_code
def march_of(frame):
    """The first operands of a call."""
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
    return March(
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
    )


@machine_code
def room_for(march):
    """Room for the bundle with the longest list."""
    return Room(
        np.empty((march.longest, march.each), np.float32),
        np.empty((march.longest, march.each), np.float32),
        np.empty((march.each, march.longest), np.uint64),
        np.empty(march.each, np.int64),
        np.empty((12, march.each), np.float32),
        np.empty(march.layout.keys, np.int32),
        np.empty(march.layout.keys, np.float32),
        np.empty(16, np.float32),
    )


@machine_code
def entries(march, bundle):
    """Where a bundle's list begins and ends."""
    first = march.start[bundle]
    last = min(first + min(march.count[bundle], march.longest), len(march.index))
    return first, last


@machine_code
def find_hits(march, room, bundle):
    """Let the entries of a bundle's list meet its rays, and note the hits."""
    first, last = entries(march, bundle)
    begin, layout, rays = bundle * march.each, march.layout, march.rays
    bits = room.t.view(np.uint32)
    room.length[:] = 0
    for k in range(layout.keys):
        room.used[k] = 0
        for r in range(march.each):
            room.used[k] |= rays.weights[k, begin + r] != _ZERO
    for e in range(last - first):
        number = march.index[first + e]
        if number < 0:
            continue
        row, t, q = march.table[number], room.t[e], room.q[e]
        if layout.keys == 1:
            a, m = nine(row), (row[9], row[10], row[11])
            if layout.window < 0:
                for r in range(march.each):
                    i = begin + r
                    o = (rays.origin[0, i], rays.origin[1, i], rays.origin[2, i])
                    d = (rays.direction[0, i], rays.direction[1, i], rays.direction[2, i])
                    t[r], q[r] = meet_ray(a, m, o, d)
            else:
                w = layout.window
                v, instant = (row[w], row[w + 1], row[w + 2]), row[w + 3]
                for r in range(march.each):
                    i = begin + r
                    age = rays.time[0, i] - instant
                    o = (
                        rays.origin[0, i] - age * v[0],
                        rays.origin[1, i] - age * v[1],
                        rays.origin[2, i] - age * v[2],
                    )
                    d = (rays.direction[0, i], rays.direction[1, i], rays.direction[2, i])
                    s = flank(age, row[w + 4], row[w + 5])
                    t[r], space = meet_ray(a, m, o, d)
                    q[r] = space + s * s
        else:
            _meet_blended(row, march, room, begin, t, q)
        limit = march.squared[number]
        for r in range(march.each):
            if q[r] < limit and t[r] > _ZERO:
                room.heap[r, room.length[r]] = np.uint64(bits[e, r]) << np.uint64(32) | np.uint64(e)
                room.length[r] += 1


@machine_code
def _ray(rays, i):
    """Origin, direction and time of a ray."""
    return (
        (rays.origin[0, i], rays.origin[1, i], rays.origin[2, i]),
        (rays.direction[0, i], rays.direction[1, i], rays.direction[2, i]),
        rays.time[0, i],
    )


@machine_code
def _note_weights(march, room, i):
    """Note the weights of a ray."""
    for k in range(march.layout.keys):
        room.weights[k] = march.rays.weights[k, i]


@machine_code
def _meet_blended(row, march, room, begin, t, q):
    """Let the rays of a bundle meet a Gaussian with key states; t and q are written."""
    layout, rays, f = march.layout, march.rays, room.blended
    f[:] = _ZERO
    for k in range(layout.keys):
        if room.used[k]:
            weights = rays.weights[k, begin : begin + march.each]
            for c in range(12):
                value, column = row[12 * k + c], f[c]
                for r in range(march.each):
                    column[r] += weights[r] * value
    w = layout.window
    for r in range(march.each):
        i = begin + r
        matrix = (f[0, r], f[1, r], f[2, r], f[3, r], f[4, r], f[5, r], f[6, r], f[7, r], f[8, r])
        x, y, z, s = f[9, r], f[10, r], f[11, r], _ZERO
        if w >= 0:
            age = rays.time[0, i] - row[w + 3]
            x, y, z = x + age * row[w], y + age * row[w + 1], z + age * row[w + 2]
            s = flank(age, row[w + 4], row[w + 5])
        o = (rays.origin[0, i], rays.origin[1, i], rays.origin[2, i])
        d = (rays.direction[0, i], rays.direction[1, i], rays.direction[2, i])
        t[r], space = meet_ray(inverse_of(matrix), (x, y, z), o, d)
        q[r] = space + s * s


@machine_code
def _sink(heap, length, at):
    """Let an entry of a heap (the smallest first) sink to its place."""
    value = heap[at]
    while True:
        child = 2 * at + 1
        if child >= length:
            break
        if child + 1 < length and heap[child + 1] < heap[child]:
            child += 1
        if not heap[child] < value:
            break
        heap[at] = heap[child]
        at = child
    heap[at] = value


@machine_code
def _order(heap, length):
    """Make a heap of what was noted in any order."""
    for at in range(length // 2 - 1, -1, -1):
        _sink(heap, length, at)


@machine_code
def begin_ray(march, room, bundle, r):
    """Number of a ray, and the ray. Its hits become a heap; its weights and the harmonics of its
    direction are noted."""
    i = bundle * march.each + r
    ray = _ray(march.rays, i)
    _order(room.heap[r], room.length[r])
    _note_weights(march, room, i)
    harmonics_of(ray[1], march.layout.coefficients, room.harmonics)
    return i, ray


@machine_code
def pop_nearest(heap, length):
    """Entry of the nearest hit of a heap, which loses it."""
    entry = np.int64(heap[0] & np.uint64(0xFFFFFFFF))
    heap[0] = heap[length - 1]
    _sink(heap, length - 1, 0)
    return entry
