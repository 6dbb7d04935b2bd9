"""Derivatives of the colours that rays see of one Gaussian, in machine code for a CPU.

All rays of a block (cpu/block.py) are taken together.
"""

import numpy as np

from gaussray.runtime.machine_code import inlined_code, machine_code, summing_code
from gaussray.scene.harmonics import C0, C1, C2, C3
from gaussray.tracer.cpu.block import (
    AT_D_HARMONICS,
    AT_G_COLOR,
    AT_HARMONICS,
    AT_KEYS,
    AT_PIXEL,
    AT_TINT,
    AT_WEIGHT,
    LANES,
    copy_row,
    lane_sum,
    product_sum,
)
from gaussray.tracer.cpu.color import blend_colors, blend_tints, light_width


_ZERO, _HALF, _TWO, _THREE = (np.float32(x) for x in (0, 0.5, 2, 3))
_FOUR, _SIX, _EIGHT = (np.float32(x) for x in (4, 6, 8))
_C0, _C1 = np.float32(C0), np.float32(C1)
_C2A, _C2B, _C2C = (np.float32(x) for x in C2)
_C3A, _C3B, _C3C, _C3D, _C3E = (np.float32(x) for x in C3)
_RED, _GREEN, _BLUE = (AT_G_COLOR + LANES * c for c in range(3))
_PIXEL_G, _PIXEL_B = AT_PIXEL + LANES, AT_PIXEL + 2 * LANES
# Tints, and weights of one key state, in rows that are written after all colours.
_TINT_R, _TINT_G, _TINT_B, _KEY = (AT_TINT + LANES * k for k in range(4))
_Y0, _Y1, _Y2, _Y3, _Y4, _Y5, _Y6, _Y7 = (AT_HARMONICS + LANES * k for k in range(8))
_Y8, _Y9, _Y10, _Y11, _Y12, _Y13, _Y14, _Y15 = (AT_HARMONICS + LANES * k for k in range(8, 16))


@machine_code
def direction_gradient(d, coefficients, g):
    """Gradient with respect to a direction, from the gradients of its harmonics.

    Args:
        d: unit direction of the ray, in world axes.
        coefficients: number of harmonics per channel.
        g: gradients with respect to the harmonics.
    """
    x, v, z = d
    gx, gy, gz = _ZERO, _ZERO, _ZERO
    if coefficients > 1:
        gx, gy, gz = -_C1 * g[3], -_C1 * g[1], _C1 * g[2]
    if coefficients > 4:
        b, c = _TWO * _C2B * g[6], _TWO * _C2C * g[8]
        gx += _C2A * (v * g[4] - z * g[7]) - b * x + c * x
        gy += _C2A * (x * g[4] - z * g[5]) - b * v - c * v
        gz += -_C2A * (v * g[5] + x * g[7]) + _TWO * b * z
    if coefficients > 9:
        a, b, c, e, f = _C3A * g[9], _C3B * g[10], _C3C * g[11], _C3D * g[12], _C3C * g[13]
        h, k = _C3E * g[14], _C3A * g[15]
        xx, yy, zz = x * x, v * v, z * z
        gx += -_SIX * a * x * v + b * v * z + _TWO * c * x * v - _SIX * e * x * z
        gx += -f * (_FOUR * zz - _THREE * xx - yy) + _TWO * h * x * z - _THREE * k * (xx - yy)
        gy += -_THREE * a * (xx - yy) + b * x * z - c * (_FOUR * zz - xx - _THREE * yy)
        gy += -_SIX * e * v * z + _TWO * f * x * v - _TWO * h * v * z + _SIX * k * x * v
        gz += b * x * v - _EIGHT * c * v * z + _THREE * e * (_TWO * zz - xx - yy)
        gz += -_EIGHT * f * x * z + h * (xx - yy)
    return gx, gy, gz


@machine_code
def add_color_gradients(row, d_row, layout, block, used, rays):
    """Add the gradients of the tinted colour that the rays saw.

    Args:
        row: row of the Gaussian.
        d_row: gradients of the row, to which is added.
        layout: columns of the row.
        block: the block, of which weights and gradients of pixels are read.
        used: which key states its rays have weights of.
        rays: whether gradients of the rays are wanted.
    """
    if light_width(layout) == 1:
        for c in range(3):
            at = layout.harmonics + c
            if _HALF + _C0 * row[at] > _ZERO:
                d_row[at] += _C0 * product_sum(block, AT_WEIGHT, AT_PIXEL + LANES * c)
        return
    blend_colors(row, layout, block)
    if layout.tint >= 0:
        _add_tint_gradients(row, d_row, layout, block, used, rays)
    else:
        # Where a colour is below zero, it is cut.
        for r in range(LANES):
            weight = block[AT_WEIGHT + r]
            red, green, blue = block[_RED + r], block[_GREEN + r], block[_BLUE + r]
            block[_RED + r] = weight * block[AT_PIXEL + r] if red > _ZERO else _ZERO
            block[_GREEN + r] = weight * block[_PIXEL_G + r] if green > _ZERO else _ZERO
            block[_BLUE + r] = weight * block[_PIXEL_B + r] if blue > _ZERO else _ZERO
    _sum_colors(d_row, layout, block)
    for k in range(1, layout.coefficients * rays):
        at, total = layout.harmonics + 3 * k, AT_D_HARMONICS + LANES * k
        red, green, blue = row[at], row[at + 1], row[at + 2]
        for r in range(LANES):
            block[total + r] += (
                red * block[_RED + r] + green * block[_GREEN + r] + blue * block[_BLUE + r]
            )


@machine_code
def _sum_colors(d_row, layout, block):
    """Add the gradients of all coefficients, of the gradients of the colours."""
    at = layout.harmonics
    if layout.coefficients == 1:
        for c in range(3):
            d_row[at + c] += _C0 * lane_sum(block, AT_G_COLOR + LANES * c)
        return
    _sum_low(d_row, at, block, _RED)
    _sum_low(d_row, at + 1, block, _GREEN)
    _sum_low(d_row, at + 2, block, _BLUE)
    if layout.coefficients > 4:
        _sum_second(d_row, at + 12, block, _RED)
        _sum_second(d_row, at + 13, block, _GREEN)
        _sum_second(d_row, at + 14, block, _BLUE)
    if layout.coefficients > 9:
        _sum_third(d_row, at + 27, block, _RED)
        _sum_third(d_row, at + 28, block, _GREEN)
        _sum_third(d_row, at + 29, block, _BLUE)


@summing_code
def _sum_low(d_row, at, block, color):
    """Add the gradients of a channel's coefficients up to degree 1."""
    a, b, c, d = _ZERO, _ZERO, _ZERO, _ZERO
    for r in range(LANES):
        g = block[color + r]
        a, b = a + g * block[_Y0 + r], b + g * block[_Y1 + r]
        c, d = c + g * block[_Y2 + r], d + g * block[_Y3 + r]
    d_row[at] += a
    d_row[at + 3] += b
    d_row[at + 6] += c
    d_row[at + 9] += d


@summing_code
def _sum_second(d_row, at, block, color):
    """Add the gradients of a channel's coefficients of degree 2."""
    a, b, c, d, e = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for r in range(LANES):
        g = block[color + r]
        a, b = a + g * block[_Y4 + r], b + g * block[_Y5 + r]
        c, d = c + g * block[_Y6 + r], d + g * block[_Y7 + r]
        e += g * block[_Y8 + r]
    d_row[at] += a
    d_row[at + 3] += b
    d_row[at + 6] += c
    d_row[at + 9] += d
    d_row[at + 12] += e


@summing_code
def _sum_third(d_row, at, block, color):
    """Add the gradients of a channel's coefficients of degree 3."""
    a, b, c, d, e, f, h = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for r in range(LANES):
        g = block[color + r]
        a, b = a + g * block[_Y9 + r], b + g * block[_Y10 + r]
        c, d = c + g * block[_Y11 + r], d + g * block[_Y12 + r]
        e, f = e + g * block[_Y13 + r], f + g * block[_Y14 + r]
        h += g * block[_Y15 + r]
    d_row[at] += a
    d_row[at + 3] += b
    d_row[at + 6] += c
    d_row[at + 9] += d
    d_row[at + 12] += e
    d_row[at + 15] += f
    d_row[at + 18] += h


@machine_code
def _add_tint_gradients(row, d_row, layout, block, used, rays):
    """Add the gradients of the tint; the rows of the colours become those of their gradients."""
    blend_tints(row, layout, block, used)
    _split_by_tint(block, _RED, _TINT_R, AT_PIXEL)
    _split_by_tint(block, _GREEN, _TINT_G, _PIXEL_G)
    _split_by_tint(block, _BLUE, _TINT_B, _PIXEL_B)
    for k in range(layout.keys):
        if not used[k] and not rays:
            continue
        copy_row(block, AT_KEYS + LANES * k, _KEY)
        _add_key_tint(row, d_row, layout.tint + 3 * k, block)
        d_w = AT_KEYS + LANES * (layout.keys + k)
        for r in range(LANES * rays):
            block[d_w + r] += block[_KEY + r]


@inlined_code
def _split_by_tint(block, color, tint, pixel):
    """The gradient of a channel's pixel becomes those of its colour and of its tint, in their
    rows; where one is below zero, it is cut."""
    for r in range(LANES):
        g = block[AT_WEIGHT + r] * block[pixel + r]
        seen, cut = max(block[color + r], _ZERO), max(block[tint + r], _ZERO)
        block[tint + r] = g * seen if cut > _ZERO else _ZERO
        block[color + r] = g * cut if seen > _ZERO else _ZERO


@summing_code
def _add_key_tint(row, d_row, at, block):
    """Add the gradients of the tint of one key state; the row of its weights becomes that of their
    gradients."""
    red, green, blue = row[at], row[at + 1], row[at + 2]
    a, b, c = _ZERO, _ZERO, _ZERO
    for r in range(LANES):
        w = block[_KEY + r]
        x, y, z = block[_TINT_R + r], block[_TINT_G + r], block[_TINT_B + r]
        a, b, c = a + w * x, b + w * y, c + w * z
        block[_KEY + r] = red * x + green * y + blue * z
    d_row[at] += a
    d_row[at + 1] += b
    d_row[at + 2] += c
