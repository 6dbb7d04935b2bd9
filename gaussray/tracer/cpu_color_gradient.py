"""Derivatives of the colours that rays see of one Gaussian, in machine code for a CPU.

All rays of a block (cpu_block.py) are taken together.
"""

import numpy as np

from gaussray.scene.harmonics import C0, C1, C2, C3
from gaussray.tracer.cpu_block import (
    AT_D_HARMONICS,
    AT_G_COLOR,
    AT_HARMONICS,
    AT_KEYS,
    AT_MATRIX,
    AT_PIXEL,
    AT_WEIGHT,
    LANES,
    product_sum,
)
from gaussray.tracer.cpu_call import machine_code


_ZERO, _HALF, _TWO, _THREE = (np.float32(x) for x in (0, 0.5, 2, 3))
_FOUR, _SIX, _EIGHT = (np.float32(x) for x in (4, 6, 8))
_C0, _C1 = np.float32(C0), np.float32(C1)
_C2A, _C2B, _C2C = (np.float32(x) for x in C2)
_C3A, _C3B, _C3C, _C3D, _C3E = (np.float32(x) for x in C3)
_RED, _GREEN, _BLUE = AT_G_COLOR, AT_G_COLOR + LANES, AT_G_COLOR + 2 * LANES


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
def add_color_gradients(row, d_row, layout, block, rays):
    """Add the gradients of the tinted colour that the rays saw.

    Args:
        row: row of the Gaussian.
        d_row: gradients of the row, to which is added.
        layout: columns of the row.
        block: the block, of which weights and gradients of pixels are read.
        rays: whether gradients of the rays are wanted.
    """
    if layout.coefficients == 1 and layout.tint < 0:
        for c in range(3):
            at = layout.harmonics + c
            if _HALF + _C0 * row[at] > _ZERO:
                d_row[at] += _C0 * product_sum(block, AT_WEIGHT, AT_PIXEL + LANES * c)
        return
    for c in range(3):
        color, pixel = AT_G_COLOR + LANES * c, AT_PIXEL + LANES * c
        # The colour before what is below zero is cut.
        for r in range(LANES):
            block[color + r] = _HALF
        for k in range(layout.coefficients):
            value, y = row[layout.harmonics + 3 * k + c], AT_HARMONICS + LANES * k
            for r in range(LANES):
                block[color + r] += value * block[y + r]
        if layout.tint >= 0:
            _add_tint_gradient(row, d_row, layout, block, rays, c)
        else:
            for r in range(LANES):
                seen = block[color + r] > _ZERO
                block[color + r] = block[AT_WEIGHT + r] * block[pixel + r] if seen else _ZERO
        for k in range(layout.coefficients):
            y = AT_HARMONICS + LANES * k
            d_row[layout.harmonics + 3 * k + c] += product_sum(block, y, color)
    for k in range(1, layout.coefficients * rays):
        at, total = layout.harmonics + 3 * k, AT_D_HARMONICS + LANES * k
        red, green, blue = row[at], row[at + 1], row[at + 2]
        for r in range(LANES):
            block[total + r] += (
                red * block[_RED + r] + green * block[_GREEN + r] + blue * block[_BLUE + r]
            )


@machine_code
def _add_tint_gradient(row, d_row, layout, block, rays, c):
    """Add the gradients of a channel's tint; the row of its colour becomes that of its gradient."""
    color, pixel = AT_G_COLOR + LANES * c, AT_PIXEL + LANES * c
    # In rows that are written after all colours.
    tint, g_tint = AT_MATRIX, AT_MATRIX + LANES
    for r in range(LANES):
        block[tint + r] = _ZERO
    for k in range(layout.keys):
        value, w = row[layout.tint + 3 * k + c], AT_KEYS + LANES * k
        for r in range(LANES):
            block[tint + r] += value * block[w + r]
    for r in range(LANES):
        g = block[AT_WEIGHT + r] * block[pixel + r]
        seen, cut = max(block[color + r], _ZERO), max(block[tint + r], _ZERO)
        block[g_tint + r] = g * seen if cut > _ZERO else _ZERO
        block[color + r] = g * cut if seen > _ZERO else _ZERO
    for k in range(layout.keys):
        at, w = layout.tint + 3 * k + c, AT_KEYS + LANES * k
        d_row[at] += product_sum(block, w, g_tint)
        value, d_w = row[at], AT_KEYS + LANES * (layout.keys + k)
        for r in range(LANES * rays):
            block[d_w + r] += value * block[g_tint + r]
