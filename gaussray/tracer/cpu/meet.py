"""The rays of a bundle side by side, and how all of them meet one Gaussian, in machine code for a
CPU.

Numbers of rays are in one array in rows of `LANES` numbers at known places, as in cpu/block.py: so
the compiler turns loops over the lanes into vector instructions. Lanes without a ray have direction
zero, which meets nothing.
"""

import math

import numpy as np

from gaussray.runtime.machine_code import allocating_code, inlined_code, machine_code, power_of_two
from gaussray.tracer.cpu.block import AT_DIRECTION, AT_ORIGIN, AT_TIME, LANES
from gaussray.tracer.cpu.hit import inverse_of, matrix_of, meet_ray, time_distance


_ZERO = np.float32(0)
# exp(-q / 2) = 2^x with x = q times this; powers below 2^_LEAST are not told apart. A number that
# _SHIFT is added to and taken from is rounded.
_EXPONENT, _LEAST, _SHIFT = np.float32(-0.5 / math.log(2)), np.float32(-126), np.float32(3 << 22)
# 2^x for |x| <= 1/2 is sum_k (x log 2)^k / k!: these eight terms miss it by less than 1e-8.
_P0, _P1, _P2, _P3, _P4, _P5, _P6, _P7 = (
    np.float32(math.log(2) ** k / math.factorial(k)) for k in range(8)
)

# Rows of `LANES` rays: origin, direction and time (cpu/block.py); distances t and q to a Gaussian;
# then weights of key states.
AT_T, AT_Q, _AT_KEYS = (LANES * n for n in (7, 8, 9))
# Rows of what key states are blended to: a matrix and a mean. They have an array of their own, so
# that the compiler knows that they do not overlap with the rays.
BLENDED = 12


@allocating_code
def new_lanes(keys):
    """Room for `LANES` rays with so many key states."""
    return np.zeros(_AT_KEYS + LANES * keys, np.float32)


@machine_code
def fill_lanes(lanes, used, layout, rays, first, count):
    """Put rays side by side.

    Args:
        lanes: the room for them.
        used: array that receives, for each key state, whether a ray has a weight of it.
        layout: columns of the rows of Gaussians.
        rays: origins, directions, weights of key states and times of all rays.
        first: index of the first ray.
        count: number of rays, at most `LANES`.
    """
    lanes[:] = _ZERO
    for c in range(3):
        for r in range(count):
            lanes[AT_ORIGIN + LANES * c + r] = rays.origin[c, first + r]
            lanes[AT_DIRECTION + LANES * c + r] = rays.direction[c, first + r]
    for r in range(count):
        lanes[AT_TIME + r] = rays.time[0, first + r]
    for k in range(layout.keys):
        used[k] = False
        for r in range(count):
            weight = rays.weights[k, first + r]
            lanes[_AT_KEYS + LANES * k + r] = weight
            used[k] |= weight != _ZERO


@machine_code
def meet_lanes(lanes, used, blended, layout, row):
    """Distance t of the peak of a Gaussian along every ray, and squared distance q there
    (`meet_ray`), in space and time; they are stored at `AT_T` and `AT_Q`.

    Args:
        lanes: the rays (`fill_lanes`).
        used: which key states they have weights of.
        blended: room for the Gaussian as each ray blends it: `BLENDED` rows of `LANES` numbers.
        layout: columns of the row.
        row: row of the Gaussian.
    """
    if layout.keys > 1:
        _meet_blended(lanes, used, blended, layout, row)
    elif layout.window < 0:
        a, m = matrix_of(row), (row[9], row[10], row[11])
        for r in range(LANES):
            lanes[AT_T + r], lanes[AT_Q + r] = meet_ray(
                a, m, _origin(lanes, r), _direction(lanes, r)
            )
    else:
        a, m, w = matrix_of(row), (row[9], row[10], row[11]), layout.window
        v, instant = (row[w], row[w + 1], row[w + 2]), row[w + 3]
        rate, plateau = row[w + 4], row[w + 5]
        for r in range(LANES):
            age, o = lanes[AT_TIME + r] - instant, _origin(lanes, r)
            o = (o[0] - age * v[0], o[1] - age * v[1], o[2] - age * v[2])
            s = time_distance(age, rate, plateau)
            lanes[AT_T + r], space = meet_ray(a, m, o, _direction(lanes, r))
            lanes[AT_Q + r] = space + s * s


@inlined_code
def _origin(lanes, r):
    at = AT_ORIGIN + r
    return lanes[at], lanes[at + LANES], lanes[at + 2 * LANES]


@inlined_code
def _direction(lanes, r):
    at = AT_DIRECTION + r
    return lanes[at], lanes[at + LANES], lanes[at + 2 * LANES]


@machine_code
def _meet_blended(lanes, used, blended, layout, row):
    """`meet_lanes` of a Gaussian that has key states, which each ray blends by its weights."""
    f, w = blended, layout.window
    f[:] = _ZERO
    for k in range(layout.keys):
        if used[k]:
            weights = lanes[_AT_KEYS + LANES * k : _AT_KEYS + LANES * (k + 1)]
            for c in range(BLENDED):
                value, column = row[BLENDED * k + c], f[c]
                for r in range(LANES):
                    column[r] += weights[r] * value
    for r in range(LANES):
        a = (f[0, r], f[1, r], f[2, r], f[3, r], f[4, r], f[5, r], f[6, r], f[7, r], f[8, r])
        x, y, z, s = f[9, r], f[10, r], f[11, r], _ZERO
        if w >= 0:
            age = lanes[AT_TIME + r] - row[w + 3]
            x, y, z = x + age * row[w], y + age * row[w + 1], z + age * row[w + 2]
            s = time_distance(age, row[w + 4], row[w + 5])
        lanes[AT_T + r], space = meet_ray(
            inverse_of(a), (x, y, z), _origin(lanes, r), _direction(lanes, r)
        )
        lanes[AT_Q + r] = space + s * s


@machine_code
def respond_lanes(lanes, opacity):
    """Replace the squared distances q (`meet_lanes`) by opacity times exp(-q / 2), to within three
    roundings: as vectors, which Numba does not make of math.exp.

    Args:
        lanes: the rays.
        opacity: opacity of the Gaussian.
    """
    for r in range(LANES):
        x = max(lanes[AT_Q + r] * _EXPONENT, _LEAST)
        shifted = x + _SHIFT
        x -= shifted - _SHIFT
        power = _P4 + x * (_P5 + x * (_P6 + x * _P7))
        power = _P0 + x * (_P1 + x * (_P2 + x * (_P3 + x * power)))
        lanes[AT_Q + r] = opacity * power * power_of_two(shifted)


@machine_code
def met_lanes(lanes, limit):
    """Which lanes hit a Gaussian, after `meet_lanes`: bits of a number, the lowest for the first.

    Args:
        lanes: the rays.
        limit: squared reach of the Gaussian.
    """
    met = np.uint64(0)
    for r in range(LANES):
        hit = (lanes[AT_Q + r] < limit) & (lanes[AT_T + r] > _ZERO)
        met |= np.uint64(hit) << np.uint64(r)
    return met
