"""Derivatives of what rays see of one Gaussian that has several key states, in machine code for a
CPU.

Each ray of a block (cpu/block.py) blends the states by weights of its own.
"""

import numpy as np

from gaussray.runtime.machine_code import machine_code, summing_code
from gaussray.tracer.cpu.block import (
    AT_G_BLENDED,
    AT_G_COLOR,
    AT_G_Q,
    AT_G_T,
    AT_KEYS,
    AT_MEAN,
    AT_TIME,
    LANES,
    copy_row,
)
from gaussray.tracer.cpu.hit import dot, inverse_of
from gaussray.tracer.cpu.meet import blend_states, blended_matrix
from gaussray.tracer.cpu.meet_gradient import (
    add_ray_gradient,
    hit_of,
    meeting_gradient,
    transposed,
    window_gradient,
    window_of,
)


_ZERO = np.float32(0)
_SIX_ZEROS = (_ZERO,) * 6
_MX, _MY, _MZ = AT_MEAN, AT_MEAN + LANES, AT_MEAN + 2 * LANES
# Rows of the gradients of the matrix and the mean as rays meet them, in halves; weights of one key
# state and their gradients, in rows that the colours no longer need.
_G_MATRIX_ROWS, _G_OTHER_ROWS = (
    tuple(first + LANES * c for c in range(6)) for first in (AT_G_BLENDED, AT_G_BLENDED + 6 * LANES)
)
_KEY, _D_KEY = AT_G_COLOR, AT_G_COLOR + LANES


@machine_code
def add_blended_gradients(row, d_row, layout, block, used, rays):
    """Add the gradients of the distances t and q, for a Gaussian with several key states.

    Args:
        row: row of the Gaussian.
        d_row: gradients of the row, to which is added.
        layout: columns of the row.
        block: the block.
        used: which key states its rays have weights of.
        rays: None if gradients of the rays are not wanted.
    """
    blend_states(block, used, layout, row)
    _meet_blended_gradients(row, d_row, layout, block, rays)
    for k in range(layout.keys):
        if not used[k] and rays is None:
            continue
        copy_row(block, AT_KEYS + LANES * k, _KEY)
        for r in range(LANES * (rays is not None)):
            block[_D_KEY + r] = _ZERO
        _add_key_gradients(row, d_row, 12 * k, block, rays, _G_MATRIX_ROWS)
        _add_key_gradients(row, d_row, 12 * k + 6, block, rays, _G_OTHER_ROWS)
        d_w = AT_KEYS + LANES * (layout.keys + k)
        for r in range(LANES * (rays is not None)):
            block[d_w + r] += block[_D_KEY + r]


@summing_code
def _add_key_gradients(row, d_row, at, block, rays, rows):
    """Add the gradients of six numbers of the matrix and the mean of a key state, and those of its
    weights."""
    a, b, c, d, e, f = row[at], row[at + 1], row[at + 2], row[at + 3], row[at + 4], row[at + 5]
    g0, g1, g2, g3, g4, g5 = _SIX_ZEROS
    for r in range(LANES):
        w = block[_KEY + r]
        x0, x1, x2 = block[rows[0] + r], block[rows[1] + r], block[rows[2] + r]
        x3, x4, x5 = block[rows[3] + r], block[rows[4] + r], block[rows[5] + r]
        g0, g1, g2 = g0 + w * x0, g1 + w * x1, g2 + w * x2
        g3, g4, g5 = g3 + w * x3, g4 + w * x4, g5 + w * x5
        if rays is not None:
            block[_D_KEY + r] += a * x0 + b * x1 + c * x2 + d * x3 + e * x4 + f * x5
    for k, total in enumerate((g0, g1, g2, g3, g4, g5)):
        d_row[at + k] += total


@summing_code
def _meet_blended_gradients(row, d_row, layout, block, rays):
    """The gradients of each ray to the matrix and the mean that were blended for it."""
    velocity, instant, rate, plateau = window_of(row, layout)
    vx, vy, vz, born, fades, lasts = _SIX_ZEROS
    for r in range(LANES):
        age = block[AT_TIME + r] - instant
        a = inverse_of(blended_matrix(block, r))
        m = (block[_MX + r], block[_MY + r], block[_MZ + r])
        (x, d), g_q = hit_of(block, r, m, velocity, age), block[AT_G_Q + r]
        g_a, g_x, g_d = meeting_gradient(a, x, d, block[AT_G_T + r], g_q)
        g_f = _gradient_of_inverse(a, g_a)
        g_age, g_rate, g_plateau = window_gradient(age, velocity, rate, plateau, g_x, g_q)
        block[AT_G_BLENDED + r] = g_f[0]
        block[AT_G_BLENDED + LANES + r] = g_f[1]
        block[AT_G_BLENDED + 2 * LANES + r] = g_f[2]
        block[AT_G_BLENDED + 3 * LANES + r] = g_f[3]
        block[AT_G_BLENDED + 4 * LANES + r] = g_f[4]
        block[AT_G_BLENDED + 5 * LANES + r] = g_f[5]
        block[AT_G_BLENDED + 6 * LANES + r] = g_f[6]
        block[AT_G_BLENDED + 7 * LANES + r] = g_f[7]
        block[AT_G_BLENDED + 8 * LANES + r] = g_f[8]
        block[AT_G_BLENDED + 9 * LANES + r] = -g_x[0]
        block[AT_G_BLENDED + 10 * LANES + r] = -g_x[1]
        block[AT_G_BLENDED + 11 * LANES + r] = -g_x[2]
        vx, vy, vz = vx - age * g_x[0], vy - age * g_x[1], vz - age * g_x[2]
        born, fades, lasts = born - g_age, fades + g_rate, lasts + g_plateau
        if rays is not None:
            add_ray_gradient(block, r, g_x, g_d, g_age)
    if layout.window >= 0:
        for k, total in enumerate((vx, vy, vz, born, fades, lasts)):
            d_row[layout.window + k] += total


@machine_code
def _gradient_of_inverse(a, g):
    """The gradient of F, of that of its inverse A: -A^T g A^T."""
    h = (
        transposed(a, (g[0], g[3], g[6])),
        transposed(a, (g[1], g[4], g[7])),
        transposed(a, (g[2], g[5], g[8])),
    )
    # h[j][i] = (A^T g)_ij; times A^T from the right.
    row0 = (h[0][0], h[1][0], h[2][0])
    row1 = (h[0][1], h[1][1], h[2][1])
    row2 = (h[0][2], h[1][2], h[2][2])
    return (
        -dot(row0, a[0:3]),
        -dot(row0, a[3:6]),
        -dot(row0, a[6:9]),
        -dot(row1, a[0:3]),
        -dot(row1, a[3:6]),
        -dot(row1, a[6:9]),
        -dot(row2, a[0:3]),
        -dot(row2, a[3:6]),
        -dot(row2, a[6:9]),
    )
