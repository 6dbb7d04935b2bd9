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
    integers,
    machine_code,
    operand,
    result,
)
from gaussray.runtime.threads import call_frame, next_piece
from gaussray.tracer.cpu.block import (
    AT_G_Q,
    AT_MATRIX,
    AT_PIXEL,
    AT_WEIGHT,
    LANES,
    fill_pixel_gradients,
)
from gaussray.tracer.cpu.bundle import (
    RayArrays,
    find_hits,
    hit_buffers,
    list_range,
    march_inputs,
)
from gaussray.tracer.cpu.gradient import add_gradients, end_block


_ZERO, _HALF, _ONE = (np.float32(x) for x in (0, 0.5, 1))
# Rows of a block while its rays are blended, after all entries are met: the transmittance in front;
# what was blended of the pixel, and how many hits; distance, alpha and light of a hit.
_FRONT, _RED, _GREEN, _BLUE, _DEPTH, _HITS = (AT_MATRIX + LANES * k for k in range(6))
_T, _ALPHA, _LIGHT_R, _LIGHT_G, _LIGHT_B = (AT_MATRIX + LANES * k for k in range(6, 11))
# On the way back: what a ray receives behind its hits so far, weighted by the gradients of its
# pixel; and whether a hit is blended.
_REST, _BLENDS = _RED, _HITS


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
        for begin in range(0, march.each, LANES):
            _blend_block(march, buffers, seen, bundle, begin)


@machine_code
def _take_hits(buffers, n):
    """Write what the n-th hits of all rays have: distance, alpha, light."""
    block, alpha, light = buffers.block, buffers.alpha, buffers.light
    width = light.shape[1] // 3
    for r in range(LANES):
        own = min(r, width - 1)
        hit = buffers.hits[n, r]
        e = hit & 0xFFFFFFFF
        buffers.bits[_T + r] = np.uint32(hit >> 32)
        block[_ALPHA + r] = alpha[e, r]
        block[_LIGHT_R + r] = light[e, own]
        block[_LIGHT_G + r] = light[e, width + own]
        block[_LIGHT_B + r] = light[e, 2 * width + own]


@machine_code
def _blend_block(march, buffers, seen, bundle, begin):
    """Blend the hits of the rays of a block, and store their channels, transmittance and number of
    hits."""
    channels, end, hits = seen
    most, block = find_hits(march, buffers, bundle, begin), buffers.block
    for r in range(LANES):
        block[_FRONT + r], block[_HITS + r], block[_DEPTH + r] = _ONE, _ZERO, _ZERO
        block[_RED + r], block[_GREEN + r], block[_BLUE + r] = _ZERO, _ZERO, _ZERO
    for n in range(most):
        _take_hits(buffers, n)
        if not _blend_hits(block, march.alpha_max, march.transmittance_min):
            break
    i = bundle * march.each + begin
    for r in range(min(LANES, march.each - begin)):
        channels[0, i + r], channels[1, i + r] = block[_RED + r], block[_GREEN + r]
        channels[2, i + r], channels[3, i + r] = block[_BLUE + r], block[_DEPTH + r]
        end[i + r], hits[i + r] = block[_FRONT + r], np.int32(block[_HITS + r])


@machine_code
def _blend_hits(block, alpha_max, transmittance_min):
    """Blend a hit of every ray whose light is not spent, and return whether there was one."""
    some = False
    for r in range(LANES):
        front, t = block[_FRONT + r], block[_T + r]
        # What stands for no hit has a distance that is not a number.
        blends = (t == t) & (front > transmittance_min)
        alpha = min(block[_ALPHA + r], alpha_max)
        weight = front * alpha
        block[_RED + r] += weight * block[_LIGHT_R + r] if blends else _ZERO
        block[_GREEN + r] += weight * block[_LIGHT_G + r] if blends else _ZERO
        block[_BLUE + r] += weight * block[_LIGHT_B + r] if blends else _ZERO
        block[_DEPTH + r] += weight * t if blends else _ZERO
        block[_FRONT + r] = front * (_ONE - alpha) if blends else front
        block[_HITS + r] += _ONE if blends else _ZERO
        some |= blends
    return some


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
def _alpha_gradients(march, buffers, pixels, found, bundle, begin):
    """Take the rays of a block through their hits once more, for the gradients of their alphas.

    The weights of their hits are stored, and in place of their alphas the gradients to their
    squared distances q; and which entries are met.
    """
    weight, met = found
    most, block = find_hits(march, buffers, bundle, begin), buffers.block
    count, i = min(LANES, march.each - begin), bundle * march.each + begin
    fill_pixel_gradients(block, pixels.g, i, count)
    for r in range(LANES):
        block[_FRONT + r], block[_REST + r] = _ONE, _ZERO
    for r in range(count):
        rest = pixels.g_end[i + r] * pixels.end[i + r]
        for c in range(4):
            rest += block[AT_PIXEL + LANES * c + r] * pixels.total[c, i + r]
        block[_REST + r] = rest
    for n in range(most):
        _take_hits(buffers, n)
        if not _split_hits(block, march.alpha_max, march.transmittance_min):
            break
        for r in range(LANES):
            # The entry that stands for none takes what is not blended.
            e = buffers.hits[n, r] & 0xFFFFFFFF if block[_BLENDS + r] > _ZERO else march.longest
            weight[e, r], met[e] = block[AT_WEIGHT + r], True
            buffers.alpha[e, r] = block[AT_G_Q + r]


@machine_code
def _split_hits(block, alpha_max, transmittance_min):
    """Gradients of a hit of every ray whose light is not spent: its weight, the gradient to its
    squared distance q, and whether it is blended; return whether one is."""
    some = False
    for r in range(LANES):
        front, t = block[_FRONT + r], block[_T + r]
        blends = (t == t) & (front > transmittance_min)
        alpha = min(block[_ALPHA + r], alpha_max)
        received = block[AT_PIXEL + r] * block[_LIGHT_R + r]
        received += block[AT_PIXEL + LANES + r] * block[_LIGHT_G + r]
        received += block[AT_PIXEL + 2 * LANES + r] * block[_LIGHT_B + r]
        received += block[AT_PIXEL + 3 * LANES + r] * t
        rest = block[_REST + r] - front * alpha * received
        d_alpha = front * received - rest / (_ONE - alpha)
        block[AT_WEIGHT + r] = front * alpha
        block[AT_G_Q + r] = -_HALF * alpha * d_alpha if alpha < alpha_max else _ZERO
        block[_REST + r] = rest if blends else block[_REST + r]
        block[_FRONT + r] = front * (_ONE - alpha) if blends else front
        block[_BLENDS + r] = _ONE if blends else _ZERO
        some |= blends
    return some


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
    weight = np.empty((march.longest + 1, LANES), np.float32)
    met = np.empty(march.longest + 1, np.bool_)
    while True:
        bundle = next_piece(shared)
        if bundle >= len(march.start):
            return
        first, last = list_range(march, bundle)
        part[first:last] = _ZERO
        for begin in range(0, march.each, LANES):
            weight[: last - first] = _ZERO
            met[: last - first] = False
            _alpha_gradients(march, buffers, pixels, (weight, met), bundle, begin)
            _add_entries(march, buffers, (weight, met, part), bundle)
            if march.differentiates_rays:
                count, i = min(LANES, march.each - begin), bundle * march.each + begin
                end_block(buffers.block, march.layout, d_rays, i, count)


@machine_code
def _add_entries(march, buffers, found, bundle):
    """Add the gradients of the rays of a block to those of the entries of the bundle's list."""
    weight, met, part = found
    first, last = list_range(march, bundle)
    for e in range(last - first):
        if met[e]:
            row, hits = march.table[march.index[first + e]], (weight[e], buffers.alpha[e])
            add_gradients(row, part[first + e], march, buffers.block, buffers.used, hits)
