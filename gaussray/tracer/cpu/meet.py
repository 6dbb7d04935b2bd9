"""How the rays of a block (cpu/block.py) meet one Gaussian, in machine code for a CPU."""

import math

import numpy as np

from gaussray.runtime.machine_code import inlined_code, machine_code, power_of_two
from gaussray.tracer.cpu.block import (
    AT_COLOR,
    AT_DIRECTION,
    AT_KEYS,
    AT_MATRIX,
    AT_MEAN,
    AT_ORIGIN,
    AT_Q,
    AT_T,
    AT_TIME,
    LANES,
    copy_row,
)
from gaussray.tracer.cpu.hit import inverse_of, matrix_of, meet_ray, time_distance


_ZERO = np.float32(0)
# exp(-q / 2) = 2^x with x = q times this; powers below 2^_LEAST are not told apart. A number that
# _SHIFT is added to and taken from is rounded.
_EXPONENT, _LEAST, _SHIFT = np.float32(-0.5 / math.log(2)), np.float32(-126), np.float32(3 << 22)
# 2^x for |x| <= 1/2 is sum_k (x log 2)^k / k!: these eight terms miss it by less than 1e-8.
_P0, _P1, _P2, _P3, _P4, _P5, _P6, _P7 = (
    np.float32(math.log(2) ** k / math.factorial(k)) for k in range(8)
)

# Rows of the matrix and the mean as rays meet them, in halves, and the weights of one key state.
_MATRIX_ROWS, _OTHER_ROWS = (
    tuple(first + LANES * c for c in range(6)) for first in (AT_MATRIX, AT_MATRIX + 6 * LANES)
)
_KEY = AT_COLOR
_MX, _MY, _MZ = AT_MEAN, AT_MEAN + LANES, AT_MEAN + 2 * LANES


@machine_code
def meet_lanes(block, used, layout, row):
    """Distance t of the peak of a Gaussian along every ray, and squared distance q there
    (`meet_ray`), in space and time; they are stored at `AT_T` and `AT_Q`.

    Args:
        block: the rays (`begin_block`).
        used: which key states they have weights of.
        layout: columns of the row.
        row: row of the Gaussian.
    """
    if layout.keys > 1:
        blend_states(block, used, layout, row)
        _meet_blended(block, layout, row)
    elif layout.window < 0:
        a, m = matrix_of(row), (row[9], row[10], row[11])
        for r in range(LANES):
            block[AT_T + r], block[AT_Q + r] = meet_ray(
                a, m, _origin(block, r), _direction(block, r)
            )
    else:
        a, m, w = matrix_of(row), (row[9], row[10], row[11]), layout.window
        v, instant = (row[w], row[w + 1], row[w + 2]), row[w + 3]
        rate, plateau = row[w + 4], row[w + 5]
        for r in range(LANES):
            age, o = block[AT_TIME + r] - instant, _origin(block, r)
            o = (o[0] - age * v[0], o[1] - age * v[1], o[2] - age * v[2])
            s = time_distance(age, rate, plateau)
            block[AT_T + r], space = meet_ray(a, m, o, _direction(block, r))
            block[AT_Q + r] = space + s * s


@inlined_code
def _origin(block, r):
    at = AT_ORIGIN + r
    return block[at], block[at + LANES], block[at + 2 * LANES]


@inlined_code
def _direction(block, r):
    at = AT_DIRECTION + r
    return block[at], block[at + LANES], block[at + 2 * LANES]


@machine_code
def blend_states(block, used, layout, row):
    """Blend the matrix and the mean of a Gaussian that has key states by the weights of each ray;
    they are stored at `AT_MATRIX` and `AT_MEAN`.

    Args:
        block: the block.
        used: which key states its rays have weights of.
        layout: columns of the row.
        row: row of the Gaussian.
    """
    for r in range(12 * LANES):
        block[AT_MATRIX + r] = _ZERO
    for k in range(layout.keys):
        if used[k]:
            copy_row(block, AT_KEYS + LANES * k, _KEY)
            _add_state(row, 12 * k, block, _MATRIX_ROWS)
            _add_state(row, 12 * k + 6, block, _OTHER_ROWS)


@inlined_code
def _add_state(row, at, block, rows):
    """Add what a key state has of six numbers of the matrix and the mean, by each ray's weight."""
    a, b, c, d, e, f = row[at], row[at + 1], row[at + 2], row[at + 3], row[at + 4], row[at + 5]
    for r in range(LANES):
        w = block[_KEY + r]
        block[rows[0] + r] += a * w
        block[rows[1] + r] += b * w
        block[rows[2] + r] += c * w
        block[rows[3] + r] += d * w
        block[rows[4] + r] += e * w
        block[rows[5] + r] += f * w


@inlined_code
def blended_matrix(block, r):
    """The matrix that a ray blends (`blend_states`), row by row.

    Args:
        block: the block.
        r: lane of the ray.
    """
    return (
        block[AT_MATRIX + r],
        block[AT_MATRIX + LANES + r],
        block[AT_MATRIX + 2 * LANES + r],
        block[AT_MATRIX + 3 * LANES + r],
        block[AT_MATRIX + 4 * LANES + r],
        block[AT_MATRIX + 5 * LANES + r],
        block[AT_MATRIX + 6 * LANES + r],
        block[AT_MATRIX + 7 * LANES + r],
        block[AT_MATRIX + 8 * LANES + r],
    )


@machine_code
def _meet_blended(block, layout, row):
    """`meet_lanes` of a Gaussian that has key states, which each ray has blended."""
    w = layout.window
    for r in range(LANES):
        x, y, z, s = block[_MX + r], block[_MY + r], block[_MZ + r], _ZERO
        if w >= 0:
            age = block[AT_TIME + r] - row[w + 3]
            x, y, z = x + age * row[w], y + age * row[w + 1], z + age * row[w + 2]
            s = time_distance(age, row[w + 4], row[w + 5])
        block[AT_T + r], space = meet_ray(
            inverse_of(blended_matrix(block, r)), (x, y, z), _origin(block, r), _direction(block, r)
        )
        block[AT_Q + r] = space + s * s


@machine_code
def store_alphas(block, opacity, alpha):
    """Store opacity times exp(-q / 2) for the squared distances q of rays (`meet_lanes`), to within
    three roundings: as vectors, which Numba does not make of math.exp.

    Args:
        block: the block.
        opacity: opacity of the Gaussian.
        alpha: array that receives the result.
    """
    for r in range(LANES):
        x = max(block[AT_Q + r] * _EXPONENT, _LEAST)
        shifted = x + _SHIFT
        x -= shifted - _SHIFT
        power = _P4 + x * (_P5 + x * (_P6 + x * _P7))
        power = _P0 + x * (_P1 + x * (_P2 + x * (_P3 + x * power)))
        alpha[r] = opacity * power * power_of_two(shifted)


@machine_code
def met_lanes(block, limit):
    """Which lanes hit a Gaussian, after `meet_lanes`: bits of a number, the lowest for the first.

    Args:
        block: the rays.
        limit: squared reach of the Gaussian.
    """
    met = np.uint64(0)
    for r in range(LANES):
        hit = (block[AT_Q + r] < limit) & (block[AT_T + r] > _ZERO)
        met |= np.uint64(hit) << np.uint64(r)
    return met
