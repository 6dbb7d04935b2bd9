"""Derivatives of what rays see of one Gaussian (cpu/hit.py), in machine code for a CPU.

All rays of a block (cpu/block.py) are taken together.
"""

import numpy as np

from gaussray.runtime.machine_code import machine_code, summing_code
from gaussray.tracer.cpu.blend_gradient import add_blended_gradients
from gaussray.tracer.cpu.block import (
    AT_D_DIRECTION,
    AT_D_HARMONICS,
    AT_D_ORIGIN,
    AT_D_TIME,
    AT_DIRECTION,
    AT_G_Q,
    AT_G_T,
    AT_KEYS,
    AT_PIXEL,
    AT_TIME,
    AT_WEIGHT,
    LANES,
    lane_sum,
)
from gaussray.tracer.cpu.color_gradient import add_color_gradients, direction_gradient
from gaussray.tracer.cpu.hit import matrix_of
from gaussray.tracer.cpu.meet_gradient import (
    add_ray_gradient,
    hit_of,
    meeting_gradient,
    window_gradient,
    window_of,
)


_ZERO, _ONE, _TWO = (np.float32(x) for x in (0, 1, 2))
_NINE, _SIX_ZEROS = (_ZERO,) * 9, (_ZERO,) * 6
_DX, _DY, _DZ = AT_DIRECTION, AT_DIRECTION + LANES, AT_DIRECTION + 2 * LANES


@machine_code
def add_gradients(row, d_row, march, block, used, hits):
    """Add the gradients of the rays' hits with a Gaussian to those of its row and of the rays.

    Args:
        row: row of the Gaussian.
        d_row: gradients of the row.
        march: inputs of the march.
        block: the block.
        used: which key states the rays have weights of.
        hits: weights of the Gaussian in the pixels of the rays, 0 for those that do not hit it; and
            gradients of the loss with respect to its squared distances q, for those that do.
    """
    weight, g_q = hits
    for r in range(LANES):
        block[AT_WEIGHT + r] = weight[r]
        block[AT_G_T + r] = weight[r] * block[AT_PIXEL + 3 * LANES + r]
        block[AT_G_Q + r] = g_q[r] if weight[r] > _ZERO else _ZERO
    layout, rays = march.layout, march.differentiates_rays
    # alpha = opacity exp(-q / 2), but where it is at its limit; there g_q is zero.
    opacity = row[layout.opacity]
    d_row[layout.opacity] -= _TWO * lane_sum(block, AT_G_Q) / (opacity if opacity > _ZERO else _ONE)
    add_color_gradients(row, d_row, layout, block, used, rays)
    # Numba compiles two versions: None leaves out what is for the rays alone.
    if layout.keys > 1 and rays:
        add_blended_gradients(row, d_row, layout, block, used, True)
    elif layout.keys > 1:
        add_blended_gradients(row, d_row, layout, block, used, None)
    elif rays:
        _add_meeting_gradients(row, d_row, layout, block, True)
    else:
        _add_meeting_gradients(row, d_row, layout, block, None)


@machine_code
def end_block(block, layout, d_rays, first, count):
    """Write the gradients of the rays of a block.

    Args:
        block: the block, when all Gaussians of its bundle have added theirs.
        layout: columns of the rows.
        d_rays: gradients of origins, directions, weights and times of all rays.
        first: index of the first ray.
        count: number of rays.
    """
    for r in range(count):
        i = first + r
        d = (block[_DX + r], block[_DY + r], block[_DZ + r])
        g = block[AT_D_HARMONICS + r : AT_KEYS : LANES]
        more = direction_gradient(d, layout.coefficients, g)
        for c in range(3):
            d_rays.origin[c, i] = block[AT_D_ORIGIN + LANES * c + r]
            d_rays.direction[c, i] = block[AT_D_DIRECTION + LANES * c + r] + more[c]
        d_rays.time[0, i] = block[AT_D_TIME + r]
        for k in range(layout.keys):
            d_rays.weights[k, i] = block[AT_KEYS + LANES * (layout.keys + k) + r]


@summing_code
def _add_meeting_gradients(row, d_row, layout, block, rays):
    """Add the gradients of the distances t and q, for a Gaussian with a single key state."""
    a, m = matrix_of(row), (row[9], row[10], row[11])
    velocity, instant, rate, plateau = window_of(row, layout)
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = _NINE
    mx, my, mz, vx, vy, vz = _SIX_ZEROS
    born, fades, lasts = _ZERO, _ZERO, _ZERO
    for r in range(LANES):
        age = block[AT_TIME + r] - instant
        (x, d), g_q = hit_of(block, r, m, velocity, age), block[AT_G_Q + r]
        g_a, g_x, g_d = meeting_gradient(a, x, d, block[AT_G_T + r], g_q)
        g_age, g_rate, g_plateau = window_gradient(age, velocity, rate, plateau, g_x, g_q)
        a0, a1, a2 = a0 + g_a[0], a1 + g_a[1], a2 + g_a[2]
        a3, a4, a5 = a3 + g_a[3], a4 + g_a[4], a5 + g_a[5]
        a6, a7, a8 = a6 + g_a[6], a7 + g_a[7], a8 + g_a[8]
        mx, my, mz = mx - g_x[0], my - g_x[1], mz - g_x[2]
        vx, vy, vz = vx - age * g_x[0], vy - age * g_x[1], vz - age * g_x[2]
        born, fades, lasts = born - g_age, fades + g_rate, lasts + g_plateau
        if rays is not None:
            add_ray_gradient(block, r, g_x, g_d, g_age)
    for k, total in enumerate((a0, a1, a2, a3, a4, a5, a6, a7, a8, mx, my, mz)):
        d_row[k] += total
    if layout.window >= 0:
        for k, total in enumerate((vx, vy, vz, born, fades, lasts)):
            d_row[layout.window + k] += total
