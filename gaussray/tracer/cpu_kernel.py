"""The march of ray bundles in machine code for a CPU: compiled once by Numba, called by XLA.

The same sums as march.py, several bundles at a time. Every ray blends its hits
(cpu_bundle.py), nearest first (at one distance: the first of the list), until its transmittance is
spent. The backward pass finds the hits again. It sums the gradients of each list's entries apart
and adds them up in the order of the lists, so that results do not depend on the threads.
"""

import math

import numpy as np

from gaussray.tracer.cpu_bundle import (
    RayArrays,
    begin_ray,
    find_hits,
    hit_buffers,
    list_range,
    march_inputs,
    pop_nearest,
)
from gaussray.tracer.cpu_call import (
    call_frame,
    flat_floats,
    floats,
    integers,
    machine_code,
    next_piece,
    operand,
    result,
)
from gaussray.tracer.cpu_gradient import (
    add_color_gradient,
    add_meeting_gradient,
    direction_gradient,
)
from gaussray.tracer.cpu_hit import clamp_positive, color_of


_ZERO, _HALF, _ONE = (np.float32(x) for x in (0, 0.5, 1))


@machine_code
def forward_bundles(shared):
    """Blend the rays of all bundles that no other thread takes."""
    frame = call_frame(shared)
    march = march_inputs(frame)
    channels, end = floats(result(frame, 0)), flat_floats(result(frame, 1))
    hits, buffers, layout = integers(result(frame, 2)), hit_buffers(march), march.layout
    weights, harmonics = buffers.weights, buffers.harmonics
    while True:
        bundle = next_piece(shared)
        if bundle >= len(march.start):
            return
        find_hits(march, buffers, bundle)
        first = march.start[bundle]
        for r in range(march.each):
            i, _ = begin_ray(march, buffers, bundle, r)
            heap, length, met = buffers.heap[r], buffers.length[r], 0
            front, red, green, blue, depth = _ONE, _ZERO, _ZERO, _ZERO, _ZERO
            while length > 0 and front > march.transmittance_min:
                e = pop_nearest(heap, length)
                length -= 1
                met += 1
                row = march.table[march.index[first + e]]
                alpha = min(
                    row[layout.opacity] * math.exp(-_HALF * buffers.q[e, r]), march.alpha_max
                )
                color, tint = color_of(row, layout, weights, harmonics)
                radiance, cut, weight = clamp_positive(color), clamp_positive(tint), front * alpha
                red += weight * radiance[0] * cut[0]
                green += weight * radiance[1] * cut[1]
                blue += weight * radiance[2] * cut[2]
                depth += weight * buffers.t[e, r]
                front *= _ONE - alpha
            channels[0, i], channels[1, i], channels[2, i], channels[3, i] = red, green, blue, depth
            end[i], hits[i] = front, met


@machine_code
def backward_bundles(shared):
    """Gradients of the rays of all bundles that no other thread takes, and of the entries of their
    lists (the last result)."""
    frame = call_frame(shared)
    march = march_inputs(frame)
    total, end = flat_floats(operand(frame, 11)), flat_floats(operand(frame, 12))
    g_total, g_end = flat_floats(operand(frame, 13)), flat_floats(operand(frame, 14))
    d_rays = RayArrays(
        floats(result(frame, 1)),
        floats(result(frame, 2)),
        floats(result(frame, 3)),
        floats(result(frame, 4)),
    )
    part = floats(result(frame, 5))
    buffers, layout, k = hit_buffers(march), march.layout, march.rays.origin.shape[1]
    weights, harmonics = buffers.weights, buffers.harmonics
    d_y, d_ray = np.empty(16, np.float32), np.empty(7 + layout.keys, np.float32)
    while True:
        bundle = next_piece(shared)
        if bundle >= len(march.start):
            return
        find_hits(march, buffers, bundle)
        first, last = list_range(march, bundle)
        part[first:last] = _ZERO
        for r in range(march.each):
            i, ray = begin_ray(march, buffers, bundle, r)
            d_y[:], d_ray[:] = _ZERO, _ZERO
            heap, length, front = buffers.heap[r], buffers.length[r], _ONE
            g = (g_total[i], g_total[k + i], g_total[2 * k + i])
            g_depth = g_total[3 * k + i]
            rest = g[0] * total[i] + g[1] * total[k + i] + g[2] * total[2 * k + i]
            rest += g_depth * total[3 * k + i] + g_end[i] * end[i]
            while length > 0 and front > march.transmittance_min:
                e = pop_nearest(heap, length)
                length -= 1
                row, d_row = march.table[march.index[first + e]], part[first + e]
                kernel = math.exp(-_HALF * buffers.q[e, r])
                alpha = min(row[layout.opacity] * kernel, march.alpha_max)
                color, tint = color_of(row, layout, weights, harmonics)
                radiance, cut, weight = clamp_positive(color), clamp_positive(tint), front * alpha
                received = (
                    g[0] * radiance[0] * cut[0]
                    + g[1] * radiance[1] * cut[1]
                    + g[2] * radiance[2] * cut[2]
                )
                received += g_depth * buffers.t[e, r]
                rest -= weight * received
                slope = (weight * g[0], weight * g[1], weight * g[2])
                d_alpha = front * received - rest / (_ONE - alpha)
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
