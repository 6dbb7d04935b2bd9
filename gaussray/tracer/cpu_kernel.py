"""The march of ray bundles in machine code for a CPU: compiled once by Numba, called by XLA.

The same sums as march.py, several bundles at a time. Every list entry meets all rays of its bundle,
in a loop that the compiler turns into vector instructions. Each ray keeps its hits in a heap and
blends them, nearest first (at one distance: the first of the list), until its transmittance is
spent. The backward pass finds the hits again. It sums the gradients of each list's entries apart
and adds them up in the order of the lists, so that results do not depend on the threads.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from gaussray.tracer.cpu_call import (
    call_frame,
    flat_floats,
    floats,
    integers,
    machine_code,
    operand,
    result,
    taken,
)
from gaussray.tracer.cpu_gradient import (
    add_color_gradient,
    add_meeting_gradient,
    direction_gradient,
)
from gaussray.tracer.cpu_hit import (
    Layout,
    color_of,
    flank,
    harmonics_of,
    meet_ray,
    nine,
    positive,
    state_on_ray,
)


_ZERO, _HALF, _ONE = (np.float32(x) for x in (0, 0.5, 1))


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
    every ray, the heap of every ray and its length; and of one ray the weights and the harmonics
    of its direction."""

    t: Any
    q: Any
    heap: Any
    length: Any
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
def _room_for(march):
    """Room for the bundle with the longest list."""
    return Room(
        np.empty((march.longest, march.each), np.float32),
        np.empty((march.longest, march.each), np.float32),
        np.empty((march.each, march.longest), np.uint64),
        np.empty(march.each, np.int64),
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
def _find_hits(march, room, bundle):
    """Let the entries of a bundle's list meet its rays, and note the hits."""
    first, last = entries(march, bundle)
    begin, layout, rays = bundle * march.each, march.layout, march.rays
    bits = room.t.view(np.uint32)
    room.length[:] = 0
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
            for r in range(march.each):
                t[r], q[r] = _met(row, march, room, begin + r)
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
def _met(row, march, room, i):
    """Distance and squared distance of a Gaussian with key states on a ray."""
    layout, (o, d, time) = march.layout, _ray(march.rays, i)
    _note_weights(march, room, i)
    a, m, age = state_on_ray(row, layout, room.weights, time)
    t, q = meet_ray(a, m, o, d)
    if layout.window >= 0:
        s = flank(age, row[layout.window + 4], row[layout.window + 5])
        q += s * s
    return t, q


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
def _begin_ray(march, room, bundle, r):
    """Number of a ray, and the ray. Its hits become a heap; its weights and the harmonics of its
    direction are noted."""
    i = bundle * march.each + r
    ray = _ray(march.rays, i)
    _order(room.heap[r], room.length[r])
    _note_weights(march, room, i)
    harmonics_of(ray[1], march.layout.coefficients, room.harmonics)
    return i, ray


@machine_code
def _pop(heap, length):
    """Entry of the nearest hit of a heap, which loses it."""
    entry = np.int64(heap[0] & np.uint64(0xFFFFFFFF))
    heap[0] = heap[length - 1]
    _sink(heap, length - 1, 0)
    return entry


@machine_code
def forward_bundles(shared):
    """Blend the rays of all bundles that no other thread takes."""
    frame = call_frame(shared)
    march = march_of(frame)
    channels, end = floats(result(frame, 0)), flat_floats(result(frame, 1))
    hits, room, layout = integers(result(frame, 2)), _room_for(march), march.layout
    weights, harmonics = room.weights, room.harmonics
    while True:
        bundle = taken(shared)
        if bundle >= len(march.start):
            return
        _find_hits(march, room, bundle)
        first = march.start[bundle]
        for r in range(march.each):
            i, _ = _begin_ray(march, room, bundle, r)
            heap, length, met = room.heap[r], room.length[r], 0
            front, red, green, blue, depth = _ONE, _ZERO, _ZERO, _ZERO, _ZERO
            while length > 0 and front > march.transmittance_min:
                e = _pop(heap, length)
                length -= 1
                met += 1
                row = march.table[march.index[first + e]]
                alpha = min(row[layout.opacity] * math.exp(-_HALF * room.q[e, r]), march.alpha_max)
                color, tint = color_of(row, layout, weights, harmonics)
                seen, cut, weight = positive(color), positive(tint), front * alpha
                red += weight * seen[0] * cut[0]
                green += weight * seen[1] * cut[1]
                blue += weight * seen[2] * cut[2]
                depth += weight * room.t[e, r]
                front *= _ONE - alpha
            channels[0, i], channels[1, i], channels[2, i], channels[3, i] = red, green, blue, depth
            end[i], hits[i] = front, met


@machine_code
def backward_bundles(shared):
    """Gradients of the rays of all bundles that no other thread takes, and of the entries of their
    lists (the last result)."""
    frame = call_frame(shared)
    march = march_of(frame)
    total, end = flat_floats(operand(frame, 11)), flat_floats(operand(frame, 12))
    g_total, g_end = flat_floats(operand(frame, 13)), flat_floats(operand(frame, 14))
    d_rays = RayArrays(
        floats(result(frame, 1)),
        floats(result(frame, 2)),
        floats(result(frame, 3)),
        floats(result(frame, 4)),
    )
    part = floats(result(frame, 5))
    room, layout, k = _room_for(march), march.layout, march.rays.origin.shape[1]
    weights, harmonics = room.weights, room.harmonics
    d_y, d_ray = np.empty(16, np.float32), np.empty(7 + layout.keys, np.float32)
    while True:
        bundle = taken(shared)
        if bundle >= len(march.start):
            return
        _find_hits(march, room, bundle)
        first, last = entries(march, bundle)
        part[first:last] = _ZERO
        for r in range(march.each):
            i, ray = _begin_ray(march, room, bundle, r)
            d_y[:], d_ray[:] = _ZERO, _ZERO
            heap, length, front = room.heap[r], room.length[r], _ONE
            g = (g_total[i], g_total[k + i], g_total[2 * k + i])
            g_depth = g_total[3 * k + i]
            rest = g[0] * total[i] + g[1] * total[k + i] + g[2] * total[2 * k + i]
            rest += g_depth * total[3 * k + i] + g_end[i] * end[i]
            while length > 0 and front > march.transmittance_min:
                e = _pop(heap, length)
                length -= 1
                row, d_row = march.table[march.index[first + e]], part[first + e]
                kernel = math.exp(-_HALF * room.q[e, r])
                alpha = min(row[layout.opacity] * kernel, march.alpha_max)
                color, tint = color_of(row, layout, weights, harmonics)
                seen, cut, weight = positive(color), positive(tint), front * alpha
                own = g[0] * seen[0] * cut[0] + g[1] * seen[1] * cut[1] + g[2] * seen[2] * cut[2]
                own += g_depth * room.t[e, r]
                rest -= weight * own
                slope = (weight * g[0], weight * g[1], weight * g[2])
                d_alpha = front * own - rest / (_ONE - alpha)
                g_q = _ZERO
                if row[layout.opacity] * kernel < march.alpha_max:
                    d_row[layout.opacity] += d_alpha * kernel
                    g_q = -_HALF * alpha * d_alpha
                add_color_gradient(row, d_row, layout, weights, d_ray, harmonics, d_y, slope)
                g_t = weight * g_depth
                add_meeting_gradient(row, d_row, layout, ray, weights, d_ray, g_t, g_q)
                front *= _ONE - alpha
            more = direction_gradient(ray[1], layout.coefficients, d_y)
            for c in range(3):
                d_rays.origin[c, i] = d_ray[c]
                d_rays.direction[c, i] = d_ray[3 + c] + more[c]
            d_rays.time[0, i] = d_ray[6]
            for c in range(layout.keys):
                d_rays.weights[c, i] = d_ray[7 + c]
