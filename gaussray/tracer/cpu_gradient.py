"""Derivatives of what rays see of one Gaussian (cpu_hit.py), in machine code for a CPU.

All rays of a block (cpu_block.py) are taken together.
"""

import numpy as np

from gaussray.tracer.cpu_block import (
    AT_D_DIRECTION,
    AT_D_HARMONICS,
    AT_D_ORIGIN,
    AT_D_TIME,
    AT_DIRECTION,
    AT_G_BLENDED,
    AT_G_Q,
    AT_G_T,
    AT_KEYS,
    AT_MATRIX,
    AT_MEAN,
    AT_ORIGIN,
    AT_PIXEL,
    AT_TIME,
    AT_WEIGHT,
    LANES,
    lane_sum,
    product_sum,
)
from gaussray.tracer.cpu_call import inlined_code, machine_code, summing_code
from gaussray.tracer.cpu_color_gradient import add_color_gradients, direction_gradient
from gaussray.tracer.cpu_hit import cross, dot, inverse_of, matrix_of


_ZERO, _ONE, _TWO = (np.float32(x) for x in (0, 1, 2))
_NINE, _SIX_ZEROS = (_ZERO,) * 9, (_ZERO,) * 6


def _three(first: int) -> tuple[int, int, int]:
    return first, first + LANES, first + 2 * LANES


_OX, _OY, _OZ = _three(AT_ORIGIN)
_DX, _DY, _DZ = _three(AT_DIRECTION)
_MX, _MY, _MZ = _three(AT_MEAN)
_SUM_OX, _SUM_OY, _SUM_OZ = _three(AT_D_ORIGIN)
_SUM_DX, _SUM_DY, _SUM_DZ = _three(AT_D_DIRECTION)


@machine_code
def add_gradients(row, d_row, march, block, weight, g_q):
    """Add the gradients of the rays' hits with a Gaussian to those of its row and of the rays.

    Args:
        row: row of the Gaussian.
        d_row: gradients of the row.
        march: inputs of the march.
        block: the block.
        weight: weights of the Gaussian in the pixels of the rays; 0 for those that do not hit it.
        g_q: gradients of the loss with respect to its squared distances q, for those that do.
    """
    for r in range(len(weight)):
        block[AT_WEIGHT + r] = weight[r]
        block[AT_G_T + r] = weight[r] * block[AT_PIXEL + 3 * LANES + r]
        block[AT_G_Q + r] = g_q[r] if weight[r] > _ZERO else _ZERO
    layout, rays = march.layout, march.differentiates_rays
    # alpha = opacity exp(-q / 2), but where it is at its limit; there g_q is zero.
    opacity = row[layout.opacity]
    d_row[layout.opacity] -= _TWO * lane_sum(block, AT_G_Q) / (opacity if opacity > _ZERO else _ONE)
    add_color_gradients(row, d_row, layout, block, rays)
    # Numba compiles two versions: None leaves out what is for the rays alone.
    if layout.keys > 1 and rays:
        _add_blended_gradients(row, d_row, layout, block, True)
    elif layout.keys > 1:
        _add_blended_gradients(row, d_row, layout, block, None)
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


@inlined_code
def _hit_of(block, r, mean, velocity, age):
    """Origin of a ray from the mean of a Gaussian, and its direction: zero where the ray does not
    hit the Gaussian, since there numbers may be too large."""
    hit = block[AT_WEIGHT + r] > _ZERO
    x = block[_OX + r] - (mean[0] + age * velocity[0])
    y = block[_OY + r] - (mean[1] + age * velocity[1])
    z = block[_OZ + r] - (mean[2] + age * velocity[2])
    dx, dy, dz = block[_DX + r], block[_DY + r], block[_DZ + r]
    place = (x if hit else _ZERO, y if hit else _ZERO, z if hit else _ZERO)
    return place, (dx if hit else _ZERO, dy if hit else _ZERO, dz if hit else _ZERO)


@inlined_code
def _add_ray_gradient(block, r, g_x, g_d, g_age):
    """Add the gradients of a ray's origin, direction and time."""
    block[_SUM_OX + r] += g_x[0]
    block[_SUM_OY + r] += g_x[1]
    block[_SUM_OZ + r] += g_x[2]
    block[_SUM_DX + r] += g_d[0]
    block[_SUM_DY + r] += g_d[1]
    block[_SUM_DZ + r] += g_d[2]
    block[AT_D_TIME + r] += g_age


@inlined_code
def _meeting_gradient(a, x, d, g_t, g_q):
    """Gradients of the distances t and q (`meet_ray`): to A, to the ray's origin from the mean, and
    to its direction.

    Args:
        a: the matrix A of the Gaussian.
        x: origin of the ray from the Gaussian's mean.
        d: unit direction of the ray.
        g_t: gradient of the loss with respect to the distance t along the ray.
        g_q: gradient with respect to the squared distance q from the Gaussian.
    """
    shift = -dot(x, d)
    p = (x[0] + shift * d[0], x[1] + shift * d[1], x[2] + shift * d[2])
    u = (dot(a[0:3], p), dot(a[3:6], p), dot(a[6:9], p))
    v = (dot(a[0:3], d), dot(a[3:6], d), dot(a[6:9], d))
    square = dot(v, v)
    inverse = _ONE / (square if square > _ZERO else _ONE)
    # t = shift - k and q = |w|^2, with k = (u.v) / (v.v) and w = u - k v = v x (u x v) / (v.v),
    # which as a product remains normal to v, however thin the Gaussian.
    k, along, s = dot(u, v) * inverse, g_t * inverse, _TWO * g_q * inverse
    w = cross(v, cross(u, v))
    g_u = (s * w[0] - along * v[0], s * w[1] - along * v[1], s * w[2] - along * v[2])
    along *= inverse
    g_v = (-k * g_u[0] - along * w[0], -k * g_u[1] - along * w[1], -k * g_u[2] - along * w[2])
    g_p = _transposed(a, g_u)
    g_d = _transposed(a, g_v)
    g_shift = g_t + dot(g_p, d)
    g_x = (g_p[0] - g_shift * d[0], g_p[1] - g_shift * d[1], g_p[2] - g_shift * d[2])
    g_d = (
        g_d[0] + shift * g_p[0] - g_shift * x[0],
        g_d[1] + shift * g_p[1] - g_shift * x[1],
        g_d[2] + shift * g_p[2] - g_shift * x[2],
    )
    g_a = (
        g_u[0] * p[0] + g_v[0] * d[0],
        g_u[0] * p[1] + g_v[0] * d[1],
        g_u[0] * p[2] + g_v[0] * d[2],
        g_u[1] * p[0] + g_v[1] * d[0],
        g_u[1] * p[1] + g_v[1] * d[1],
        g_u[1] * p[2] + g_v[1] * d[2],
        g_u[2] * p[0] + g_v[2] * d[0],
        g_u[2] * p[1] + g_v[2] * d[1],
        g_u[2] * p[2] + g_v[2] * d[2],
    )
    return g_a, g_x, g_d


@inlined_code
def _window_gradient(age, v, rate, plateau, g_x, g_q):
    """Gradients of a transient Gaussian's motion and window: to the age, 1 / lifetime, plateau."""
    beyond = abs(age) - plateau
    slope = _TWO * g_q * beyond * rate if beyond > _ZERO else _ZERO
    g_age = -dot(g_x, v) + (slope * rate if age > _ZERO else -slope * rate)
    return g_age, slope * beyond, -slope * rate


@inlined_code
def _window_of(row, layout):
    """Velocity, instant, 1 / lifetime and plateau; a Gaussian without window stands still."""
    if layout.window >= 0:
        w = layout.window
        return (row[w], row[w + 1], row[w + 2]), row[w + 3], row[w + 4], row[w + 5]
    return (_ZERO, _ZERO, _ZERO), _ZERO, _ZERO, _ZERO


@summing_code
def _add_meeting_gradients(row, d_row, layout, block, rays):
    """Add the gradients of the distances t and q, for a Gaussian with a single key state."""
    a, m = matrix_of(row), (row[9], row[10], row[11])
    velocity, instant, rate, plateau = _window_of(row, layout)
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = _NINE
    mx, my, mz, vx, vy, vz = _SIX_ZEROS
    born, fades, lasts = _ZERO, _ZERO, _ZERO
    for r in range(LANES):
        age = block[AT_TIME + r] - instant
        (x, d), g_q = _hit_of(block, r, m, velocity, age), block[AT_G_Q + r]
        g_a, g_x, g_d = _meeting_gradient(a, x, d, block[AT_G_T + r], g_q)
        g_age, g_rate, g_plateau = _window_gradient(age, velocity, rate, plateau, g_x, g_q)
        a0, a1, a2 = a0 + g_a[0], a1 + g_a[1], a2 + g_a[2]
        a3, a4, a5 = a3 + g_a[3], a4 + g_a[4], a5 + g_a[5]
        a6, a7, a8 = a6 + g_a[6], a7 + g_a[7], a8 + g_a[8]
        mx, my, mz = mx - g_x[0], my - g_x[1], mz - g_x[2]
        vx, vy, vz = vx - age * g_x[0], vy - age * g_x[1], vz - age * g_x[2]
        born, fades, lasts = born - g_age, fades + g_rate, lasts + g_plateau
        if rays is not None:
            _add_ray_gradient(block, r, g_x, g_d, g_age)
    for k, total in enumerate((a0, a1, a2, a3, a4, a5, a6, a7, a8, mx, my, mz)):
        d_row[k] += total
    if layout.window >= 0:
        for k, total in enumerate((vx, vy, vz, born, fades, lasts)):
            d_row[layout.window + k] += total


@machine_code
def _add_blended_gradients(row, d_row, layout, block, rays):
    """Add the gradients of the distances t and q, for a Gaussian with several key states."""
    for c in range(12):
        blended = AT_MATRIX + LANES * c
        for r in range(LANES):
            block[blended + r] = _ZERO
        for k in range(layout.keys):
            value, w = row[12 * k + c], AT_KEYS + LANES * k
            for r in range(LANES):
                block[blended + r] += value * block[w + r]
    _meet_blended_gradients(row, d_row, layout, block, rays)
    for k in range(layout.keys):
        w, d_w = AT_KEYS + LANES * k, AT_KEYS + LANES * (layout.keys + k)
        for c in range(12):
            value, g = row[12 * k + c], AT_G_BLENDED + LANES * c
            d_row[12 * k + c] += product_sum(block, w, g)
            if rays is not None:
                for r in range(LANES):
                    block[d_w + r] += value * block[g + r]


@summing_code
def _meet_blended_gradients(row, d_row, layout, block, rays):
    """The gradients of each ray to the matrix and the mean that were blended for it."""
    velocity, instant, rate, plateau = _window_of(row, layout)
    vx, vy, vz, born, fades, lasts = _SIX_ZEROS
    for r in range(LANES):
        age = block[AT_TIME + r] - instant
        a = inverse_of(
            (
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
        )
        m = (block[_MX + r], block[_MY + r], block[_MZ + r])
        (x, d), g_q = _hit_of(block, r, m, velocity, age), block[AT_G_Q + r]
        g_a, g_x, g_d = _meeting_gradient(a, x, d, block[AT_G_T + r], g_q)
        g_f = _gradient_of_inverse(a, g_a)
        g_age, g_rate, g_plateau = _window_gradient(age, velocity, rate, plateau, g_x, g_q)
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
            _add_ray_gradient(block, r, g_x, g_d, g_age)
    if layout.window >= 0:
        for k, total in enumerate((vx, vy, vz, born, fades, lasts)):
            d_row[layout.window + k] += total


@machine_code
def _transposed(a, v):
    """The transpose of a matrix times a vector."""
    return (
        a[0] * v[0] + a[3] * v[1] + a[6] * v[2],
        a[1] * v[0] + a[4] * v[1] + a[7] * v[2],
        a[2] * v[0] + a[5] * v[1] + a[8] * v[2],
    )


@machine_code
def _gradient_of_inverse(a, g):
    """The gradient of F, of that of its inverse A: -A^T g A^T."""
    h = (
        _transposed(a, (g[0], g[3], g[6])),
        _transposed(a, (g[1], g[4], g[7])),
        _transposed(a, (g[2], g[5], g[8])),
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
