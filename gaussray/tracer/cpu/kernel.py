"""The march of ray bundles in machine code for a CPU: compiled once by Numba, called by XLA.

The same sums as march.py, several bundles at a time. Every ray blends its hits
(cpu/bundle.py), nearest first (at one distance: the first of the list), until its transmittance is
spent. The backward pass finds the hits again. It sums the gradients of each list's entries apart
and adds them up in the order of the lists, so that results do not depend on the threads.
"""

from typing import Any, NamedTuple

import numpy as np

from gaussray.runtime.machine_code import (
    allocating_code,
    flat_floats,
    floats,
    inlined_code,
    integers,
    machine_code,
    operand,
    result,
)
from gaussray.runtime.threads import call_frame, next_piece
from gaussray.tracer.cpu.block import LANES, begin_block, new_block
from gaussray.tracer.cpu.bundle import (
    RayArrays,
    begin_ray,
    find_hits,
    hit_buffers,
    list_range,
    march_inputs,
    pop_nearest,
)
from gaussray.tracer.cpu.gradient import add_gradients, end_block
from gaussray.tracer.cpu.hit import clamp_positive, color_of


_ZERO, _HALF, _ONE = (np.float32(x) for x in (0, 0.5, 1))


@allocating_code
def forward_bundles(shared):
    """Blend the rays of all bundles that no other thread takes."""
    frame = call_frame(shared)
    march = march_inputs(frame)
    seen = (
        floats(result(frame, 0)),
        flat_floats(result(frame, 1)),
        integers(result(frame, 2)),
    )
    buffers = hit_buffers(march)
    while True:
        bundle = next_piece(shared)
        if bundle >= len(march.start):
            return
        find_hits(march, buffers, bundle)
        for r in range(march.each):
            _blend_ray(march, buffers, seen, bundle, r)


@inlined_code
def _next_hit(march, buffers, bundle, r):
    """The nearest hit of a ray that was not taken yet: its list entry, alpha and light."""
    e = pop_nearest(buffers, r)
    row = march.table[march.index[march.start[bundle] + e]]
    alpha = min(buffers.alpha[r // LANES, e, r % LANES], march.alpha_max)
    color, tint = color_of(row, march.layout, buffers.weights, buffers.harmonics)
    color, tint = clamp_positive(color), clamp_positive(tint)
    return e, alpha, (color[0] * tint[0], color[1] * tint[1], color[2] * tint[2])


@machine_code
def _blend_ray(march, buffers, seen, bundle, r):
    """Blend the hits of a ray, and store its channels, transmittance and number of hits."""
    channels, end, hits = seen
    i, met = begin_ray(march, buffers, bundle, r), 0
    t, lane, front = buffers.t[r // LANES], r % LANES, _ONE
    red, green, blue, depth = _ZERO, _ZERO, _ZERO, _ZERO
    while met < buffers.length[r] and front > march.transmittance_min:
        e, alpha, light = _next_hit(march, buffers, bundle, r)
        met += 1
        weight = front * alpha
        red += weight * light[0]
        green += weight * light[1]
        blue += weight * light[2]
        depth += weight * t[e, lane]
        front *= _ONE - alpha
    channels[0, i], channels[1, i], channels[2, i], channels[3, i] = red, green, blue, depth
    end[i], hits[i] = front, met


class PixelGradients(NamedTuple):
    """What the rays saw, and gradients of the loss.

    Args:
        total: red, green, blue and depth of every ray.
        end: transmittance of every ray.
        g: gradients with respect to `total`.
        g_end: gradient with respect to `end`.
    """

    total: Any
    end: Any
    g: Any
    g_end: Any


@machine_code
def _alpha_gradients(march, buffers, pixels, found, bundle, r):
    """Take a ray through its hits once more, for the gradients of their alphas.

    The weights of its hits are stored, and in place of their alphas the gradients to their squared
    distances q; and which entries are met.
    """
    weight, met = found
    t, raw, lane = buffers.t[r // LANES], buffers.alpha[r // LANES], r % LANES
    i = begin_ray(march, buffers, bundle, r)
    red, green, blue, depth = pixels.g[0, i], pixels.g[1, i], pixels.g[2, i], pixels.g[3, i]
    rest = red * pixels.total[0, i] + green * pixels.total[1, i] + blue * pixels.total[2, i]
    rest += depth * pixels.total[3, i] + pixels.g_end[i] * pixels.end[i]
    front, at = _ONE, 0
    while at < buffers.length[r] and front > march.transmittance_min:
        e, alpha, light = _next_hit(march, buffers, bundle, r)
        at += 1
        received = red * light[0] + green * light[1] + blue * light[2] + depth * t[e, lane]
        rest -= front * alpha * received
        d_alpha = front * received - rest / (_ONE - alpha)
        weight[e, r], met[e] = front * alpha, True
        raw[e, lane] = -_HALF * alpha * d_alpha if alpha < march.alpha_max else _ZERO
        front *= _ONE - alpha


@allocating_code
def backward_bundles(shared):
    """Gradients of the rays of all bundles that no other thread takes, if they are wanted, and of
    the entries of their lists (the last result).

    Ray by ray, what each hit adds to a pixel gives the gradients to its alpha. Then entry by entry,
    all its hits add theirs to the Gaussian and the rays (cpu/gradient.py).
    """
    frame = call_frame(shared)
    march = march_inputs(frame)
    pixels = PixelGradients(
        floats(operand(frame, 11)),
        flat_floats(operand(frame, 12)),
        floats(operand(frame, 13)),
        flat_floats(operand(frame, 14)),
    )
    d_rays = RayArrays(
        floats(result(frame, 1)),
        floats(result(frame, 2)),
        floats(result(frame, 3)),
        floats(result(frame, 4)),
    )
    part, buffers = floats(result(frame, 5)), hit_buffers(march)
    block = new_block(march.layout.keys)
    weight = np.empty((march.longest, march.each), np.float32)
    met = np.empty(march.longest, np.bool_)
    while True:
        bundle = next_piece(shared)
        if bundle >= len(march.start):
            return
        find_hits(march, buffers, bundle)
        first, last = list_range(march, bundle)
        part[first:last] = _ZERO
        weight[: last - first] = _ZERO
        met[: last - first] = False
        for r in range(march.each):
            _alpha_gradients(march, buffers, pixels, (weight, met), bundle, r)
        for begin in range(0, march.each, LANES):
            count, i = min(LANES, march.each - begin), bundle * march.each + begin
            begin_block(block, march.layout, march.rays, pixels.g, i, count)
            _add_entries(march, buffers, block, (weight, met, part), bundle, begin)
            if march.differentiates_rays:
                end_block(block, march.layout, d_rays, i, count)


@machine_code
def _add_entries(march, buffers, block, found, bundle, begin):
    """Add the gradients of the rays of a block, from number `begin` of a bundle on."""
    weight, met, part = found
    first, last = list_range(march, bundle)
    count = min(LANES, march.each - begin)
    for e in range(last - first):
        if met[e]:
            row, d_row = march.table[march.index[first + e]], part[first + e]
            own, g_q = weight[e, begin : begin + count], buffers.alpha[begin // LANES, e, :count]
            add_gradients(row, d_row, march, block, own, g_q)
