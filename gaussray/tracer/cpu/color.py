"""The colours that rays see of one Gaussian, in machine code for a CPU: the equations of
harmonics.py.

All rays of a block (cpu/block.py) are taken together.
"""

import numpy as np

from gaussray.runtime.machine_code import inlined_code, machine_code
from gaussray.scene.harmonics import C0
from gaussray.tracer.cpu.block import (
    AT_COLOR,
    AT_HARMONICS,
    AT_KEYS,
    AT_TINT,
    LANES,
    copy_row,
)


_ZERO, _HALF, _C0 = (np.float32(x) for x in (0, 0.5, C0))
_RED, _GREEN, _BLUE = (AT_COLOR + LANES * c for c in range(3))
# Tints, and weights of one key state.
_TINT_R, _TINT_G, _TINT_B, _KEY = (AT_TINT + LANES * k for k in range(4))
_Y0, _Y1, _Y2, _Y3, _Y4, _Y5, _Y6, _Y7 = (AT_HARMONICS + LANES * k for k in range(8))
_Y8, _Y9, _Y10, _Y11, _Y12, _Y13, _Y14, _Y15 = (AT_HARMONICS + LANES * k for k in range(8, 16))


# Written out for each degree: loops over rows that are found at run time take five times as long.
@machine_code
def blend_colors(row, layout, block):
    """Write the colours that rays see at `AT_COLOR`, before what is below zero is cut.

    Args:
        row: row of the Gaussian.
        layout: columns of the row.
        block: the block, of which harmonics are read.
    """
    at = layout.harmonics
    if layout.coefficients == 1:
        red, green, blue = (
            _HALF + _C0 * row[at],
            _HALF + _C0 * row[at + 1],
            _HALF + _C0 * row[at + 2],
        )
        for r in range(LANES):
            block[_RED + r], block[_GREEN + r], block[_BLUE + r] = red, green, blue
        return
    for r in range(LANES):
        y = block[_Y0 + r], block[_Y1 + r], block[_Y2 + r], block[_Y3 + r]
        block[_RED + r] = _HALF + _weighted_4(row, at, y)
        block[_GREEN + r] = _HALF + _weighted_4(row, at + 1, y)
        block[_BLUE + r] = _HALF + _weighted_4(row, at + 2, y)
    if layout.coefficients > 4:
        at += 12
        for r in range(LANES):
            y = block[_Y4 + r], block[_Y5 + r], block[_Y6 + r], block[_Y7 + r], block[_Y8 + r]
            block[_RED + r] += _weighted_5(row, at, y)
            block[_GREEN + r] += _weighted_5(row, at + 1, y)
            block[_BLUE + r] += _weighted_5(row, at + 2, y)
    if layout.coefficients > 9:
        at += 15
        for r in range(LANES):
            y = block[_Y9 + r], block[_Y10 + r], block[_Y11 + r], block[_Y12 + r]
            z = block[_Y13 + r], block[_Y14 + r], block[_Y15 + r]
            block[_RED + r] += _weighted_4(row, at, y) + _weighted_3(row, at + 12, z)
            block[_GREEN + r] += _weighted_4(row, at + 1, y) + _weighted_3(row, at + 13, z)
            block[_BLUE + r] += _weighted_4(row, at + 2, y) + _weighted_3(row, at + 14, z)


@inlined_code
def _weighted_3(row, at, y):
    """Harmonics times a channel's coefficients, three of them."""
    return row[at] * y[0] + row[at + 3] * y[1] + row[at + 6] * y[2]


@inlined_code
def _weighted_4(row, at, y):
    """Harmonics times a channel's coefficients, four of them."""
    return _weighted_3(row, at, y) + row[at + 9] * y[3]


@inlined_code
def _weighted_5(row, at, y):
    """Harmonics times a channel's coefficients, five of them."""
    return _weighted_4(row, at, y) + row[at + 12] * y[4]


@machine_code
def blend_tints(row, layout, block, used):
    """Write the tints that rays see at `AT_TINT`, before what is below zero is cut.

    Args:
        row: row of the Gaussian, which has a tint.
        layout: columns of the row.
        block: the block, of which weights of key states are read.
        used: which key states its rays have weights of.
    """
    for r in range(LANES):
        block[_TINT_R + r], block[_TINT_G + r], block[_TINT_B + r] = _ZERO, _ZERO, _ZERO
    for k in range(layout.keys):
        if not used[k]:
            continue
        at = layout.tint + 3 * k
        red, green, blue = row[at], row[at + 1], row[at + 2]
        copy_row(block, AT_KEYS + LANES * k, _KEY)
        for r in range(LANES):
            w = block[_KEY + r]
            block[_TINT_R + r] += red * w
            block[_TINT_G + r] += green * w
            block[_TINT_B + r] += blue * w


@inlined_code
def light_width(layout):
    """Rays that see a colour of their own: `LANES`, or 1 if all see the same."""
    return 1 if layout.coefficients == 1 and layout.tint < 0 else LANES


@machine_code
def store_light(row, layout, block, used, light):
    """Store the tinted colours that rays see; what is below zero is cut.

    Args:
        row: row of the Gaussian.
        layout: columns of the row.
        block: the block.
        used: which key states its rays have weights of.
        light: array that receives red of every ray, then green, then blue (`light_width` each).
    """
    if light_width(layout) == 1:
        for c in range(3):
            light[c] = max(_HALF + _C0 * row[layout.harmonics + c], _ZERO)
        return
    blend_colors(row, layout, block)
    if layout.tint >= 0:
        blend_tints(row, layout, block, used)
        for r in range(LANES):
            block[_RED + r] *= max(block[_TINT_R + r], _ZERO)
            block[_GREEN + r] *= max(block[_TINT_G + r], _ZERO)
            block[_BLUE + r] *= max(block[_TINT_B + r], _ZERO)
    for r in range(LANES):
        light[r] = max(block[_RED + r], _ZERO)
        light[LANES + r] = max(block[_GREEN + r], _ZERO)
        light[2 * LANES + r] = max(block[_BLUE + r], _ZERO)
