"""Derivatives of what rays see of one Gaussian (cpu_hit.py), in machine code for a CPU.

A Gaussian meets `LANES` rays of a bundle at a time, in loops that the compiler turns into vector
instructions. All numbers of these rays are in one array, the block, in rows of `LANES` numbers at
known places: so the compiler knows that they do not overlap. Lanes without a ray, or whose ray did
not hit the Gaussian, have a weight and gradients of zero, and add nothing.
"""

import numpy as np

from gaussray.scene.harmonics import C0, C1, C2, C3
from gaussray.tracer.cpu_call import inlined_code, machine_code, summing_code
from gaussray.tracer.cpu_hit import cross, dot, harmonics_of, inverse_of, matrix_of


_ZERO, _HALF, _ONE, _TWO, _THREE = (np.float32(x) for x in (0, 0.5, 1, 2, 3))
_FOUR, _SIX, _EIGHT = (np.float32(x) for x in (4, 6, 8))
_NINE, _SIX_ZEROS = (_ZERO,) * 9, (_ZERO,) * 6
_C0, _C1 = np.float32(C0), np.float32(C1)
_C2A, _C2B, _C2C = (np.float32(x) for x in C2)
_C3A, _C3B, _C3C, _C3D, _C3E = (np.float32(x) for x in C3)

# Rays of a block: those of the usual bundle.
LANES = 64
# First rows of a block. Of the rays: origin, direction and time, harmonics of the direction,
# gradient of the loss with respect to the pixel's colour.
ORIGIN, DIRECTION, TIME, HARMONICS, PIXEL = (LANES * n for n in (0, 3, 6, 7, 23))
# Of their hits with one Gaussian: weight; gradients with respect to the distances t and q, and to
# the harmonics' sums, once tint and what is below zero are counted.
WEIGHT, G_T, G_Q, G_COLOR = (LANES * n for n in (26, 27, 28, 29))
# The Gaussian as each ray meets it, if that differs: matrix A, mean; gradients to what was blended.
MATRIX, MEAN, G_BLENDED = (LANES * n for n in (32, 41, 44))
# Sums of gradients over all Gaussians: origin, direction, time, harmonics.
D_ORIGIN, D_DIRECTION, D_TIME, D_HARMONICS = (LANES * n for n in (56, 59, 62, 63))
# Rows of weights of key states follow, then their gradients.
_ROWS = 79
KEYS = LANES * _ROWS


def _three(first: int) -> tuple[int, int, int]:
    return first, first + LANES, first + 2 * LANES


_OX, _OY, _OZ = _three(ORIGIN)
_DX, _DY, _DZ = _three(DIRECTION)
_MX, _MY, _MZ = _three(MEAN)
_RED, _GREEN, _BLUE = _three(G_COLOR)
_SUM_OX, _SUM_OY, _SUM_OZ = _three(D_ORIGIN)
_SUM_DX, _SUM_DY, _SUM_DZ = _three(D_DIRECTION)


@machine_code
def new_block(keys):
    """A block for scenes of so many key states, all zero."""
    return np.zeros(KEYS + 2 * keys * LANES, np.float32)


@machine_code
def begin_block(block, layout, rays, first, count):
    """Fill in the rays of a block, and set the gradients of all to zero.

    Args:
        block: the block.
        layout: columns of the rows.
        rays: origins, directions, weights of key states and times of all rays.
        first: index of the first ray.
        count: number of rays, at most `LANES`.
    """
    block[:] = _ZERO
    y = np.zeros(16, np.float32)
    for r in range(count):
        i = first + r
        for c in range(3):
            block[ORIGIN + LANES * c + r] = rays.origin[c, i]
            block[DIRECTION + LANES * c + r] = rays.direction[c, i]
        block[TIME + r] = rays.time[0, i]
        d = (rays.direction[0, i], rays.direction[1, i], rays.direction[2, i])
        harmonics_of(d, layout.coefficients, y)
        for k in range(layout.coefficients):
            block[HARMONICS + LANES * k + r] = y[k]
        for k in range(layout.keys):
            block[KEYS + LANES * k + r] = rays.weights[k, i]


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
    g = np.zeros(16, np.float32)
    for r in range(count):
        i = first + r
        d = (block[_DX + r], block[_DY + r], block[_DZ + r])
        for k in range(layout.coefficients):
            g[k] = block[D_HARMONICS + LANES * k + r]
        more = direction_gradient(d, layout.coefficients, g)
        for c in range(3):
            d_rays.origin[c, i] = block[D_ORIGIN + LANES * c + r]
            d_rays.direction[c, i] = block[D_DIRECTION + LANES * c + r] + more[c]
        d_rays.time[0, i] = block[D_TIME + r]
        for k in range(layout.keys):
            d_rays.weights[k, i] = block[KEYS + LANES * (layout.keys + k) + r]


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


@summing_code
def _product_sum(block, one, other):
    """Sum over the lanes of the products of two rows."""
    total = _ZERO
    for r in range(LANES):
        total += block[one + r] * block[other + r]
    return total


@summing_code
def _sum(block, row):
    """Sum of a row over the lanes."""
    total = _ZERO
    for r in range(LANES):
        total += block[row + r]
    return total


@summing_code
def opacity_gradient(opacity, block):
    """The gradient of a Gaussian's opacity: of alpha = opacity exp(-q / 2), as of q, but where
    alpha is at its limit.

    Args:
        opacity: the opacity.
        block: the block; `G_Q` is read.
    """
    return -_TWO * _sum(block, G_Q) / (opacity if opacity > _ZERO else _ONE)


@machine_code
def add_color_gradients(row, d_row, layout, block):
    """Add the gradients of the tinted colour that the rays saw.

    Args:
        row: row of the Gaussian.
        d_row: gradients of the row, to which is added.
        layout: columns of the row.
        block: the block; `WEIGHT` and `PIXEL` are read, gradients of rays are added to.
    """
    if layout.coefficients == 1 and layout.tint < 0:
        for c in range(3):
            at = layout.harmonics + c
            if _HALF + _C0 * row[at] > _ZERO:
                d_row[at] += _C0 * _product_sum(block, WEIGHT, PIXEL + LANES * c)
        return
    for c in range(3):
        color, pixel = G_COLOR + LANES * c, PIXEL + LANES * c
        # The colour before what is below zero is cut.
        for r in range(LANES):
            block[color + r] = _HALF
        for k in range(layout.coefficients):
            value, y = row[layout.harmonics + 3 * k + c], HARMONICS + LANES * k
            for r in range(LANES):
                block[color + r] += value * block[y + r]
        if layout.tint >= 0:
            _add_tint_gradient(row, d_row, layout, block, c)
        else:
            for r in range(LANES):
                seen = block[color + r] > _ZERO
                block[color + r] = block[WEIGHT + r] * block[pixel + r] if seen else _ZERO
        for k in range(layout.coefficients):
            y = HARMONICS + LANES * k
            d_row[layout.harmonics + 3 * k + c] += _product_sum(block, y, color)
    for k in range(1, layout.coefficients):
        at, total = layout.harmonics + 3 * k, D_HARMONICS + LANES * k
        red, green, blue = row[at], row[at + 1], row[at + 2]
        for r in range(LANES):
            block[total + r] += (
                red * block[_RED + r] + green * block[_GREEN + r] + blue * block[_BLUE + r]
            )


@machine_code
def _add_tint_gradient(row, d_row, layout, block, c):
    """Add the gradients of a channel's tint; the row of its colour becomes that of its gradient."""
    color, pixel, tint, g_tint = G_COLOR + LANES * c, PIXEL + LANES * c, MATRIX, MATRIX + LANES
    for r in range(LANES):
        block[tint + r] = _ZERO
    for k in range(layout.keys):
        value, w = row[layout.tint + 3 * k + c], KEYS + LANES * k
        for r in range(LANES):
            block[tint + r] += value * block[w + r]
    for r in range(LANES):
        g = block[WEIGHT + r] * block[pixel + r]
        seen, cut = max(block[color + r], _ZERO), max(block[tint + r], _ZERO)
        block[g_tint + r] = g * seen if cut > _ZERO else _ZERO
        block[color + r] = g * cut if seen > _ZERO else _ZERO
    for k in range(layout.keys):
        at, w = layout.tint + 3 * k + c, KEYS + LANES * k
        d_row[at] += _product_sum(block, w, g_tint)
        value, d_w = row[at], KEYS + LANES * (layout.keys + k)
        for r in range(LANES):
            block[d_w + r] += value * block[g_tint + r]


@inlined_code
def _where(hit, x):
    """A vector, zero in lanes whose ray did not hit the Gaussian: there it may be too large."""
    return x[0] if hit else _ZERO, x[1] if hit else _ZERO, x[2] if hit else _ZERO


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
    c = cross(u, v)
    # t = shift - (u.v) / (v.v), q = |u x v|^2 / (v.v).
    g_inverse = dot(c, c) * g_q - dot(u, v) * g_t
    s = _TWO * g_q * inverse
    along = -inverse * g_t
    around_u, around_v = cross(v, c), cross(c, u)
    back = -_TWO * (g_inverse * inverse) * inverse
    g_u = (
        s * around_u[0] + along * v[0],
        s * around_u[1] + along * v[1],
        s * around_u[2] + along * v[2],
    )
    g_v = (
        s * around_v[0] + along * u[0] + back * v[0],
        s * around_v[1] + along * u[1] + back * v[1],
        s * around_v[2] + along * u[2] + back * v[2],
    )
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
def add_meeting_gradients(row, d_row, layout, block):
    """Add the gradients of the distances t and q of the rays to those of a Gaussian with a single
    key state, and to those of the rays.

    Args:
        row: row of the Gaussian.
        d_row: gradients of the row, to which is added.
        layout: columns of the row.
        block: the block; `G_T` and `G_Q` are read, gradients of rays are added to.
    """
    a, m = matrix_of(row), (row[9], row[10], row[11])
    velocity, instant, rate, plateau = _window_of(row, layout)
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = _NINE
    mx, my, mz, vx, vy, vz = _SIX_ZEROS
    born, fades, lasts = _ZERO, _ZERO, _ZERO
    for r in range(LANES):
        age = block[TIME + r] - instant
        x = (
            block[_OX + r] - m[0] - age * velocity[0],
            block[_OY + r] - m[1] - age * velocity[1],
            block[_OZ + r] - m[2] - age * velocity[2],
        )
        hit, g_q = block[WEIGHT + r] > _ZERO, block[G_Q + r]
        x, d = _where(hit, x), _where(hit, (block[_DX + r], block[_DY + r], block[_DZ + r]))
        g_a, g_x, g_d = _meeting_gradient(a, x, d, block[G_T + r], g_q)
        g_age, g_rate, g_plateau = _window_gradient(age, velocity, rate, plateau, g_x, g_q)
        a0, a1, a2 = a0 + g_a[0], a1 + g_a[1], a2 + g_a[2]
        a3, a4, a5 = a3 + g_a[3], a4 + g_a[4], a5 + g_a[5]
        a6, a7, a8 = a6 + g_a[6], a7 + g_a[7], a8 + g_a[8]
        mx, my, mz = mx - g_x[0], my - g_x[1], mz - g_x[2]
        vx, vy, vz = vx - age * g_x[0], vy - age * g_x[1], vz - age * g_x[2]
        born, fades, lasts = born - g_age, fades + g_rate, lasts + g_plateau
        block[_SUM_OX + r] += g_x[0]
        block[_SUM_OY + r] += g_x[1]
        block[_SUM_OZ + r] += g_x[2]
        block[_SUM_DX + r] += g_d[0]
        block[_SUM_DY + r] += g_d[1]
        block[_SUM_DZ + r] += g_d[2]
        block[D_TIME + r] += g_age
    for k, total in enumerate((a0, a1, a2, a3, a4, a5, a6, a7, a8, mx, my, mz)):
        d_row[k] += total
    if layout.window >= 0:
        for k, total in enumerate((vx, vy, vz, born, fades, lasts)):
            d_row[layout.window + k] += total


@machine_code
def add_blended_gradients(row, d_row, layout, block):
    """Like `add_meeting_gradients`, for a Gaussian with several key states.

    Args:
        row: row of the Gaussian.
        d_row: gradients of the row, to which is added.
        layout: columns of the row.
        block: the block; `G_T` and `G_Q` are read, gradients of rays are added to.
    """
    for c in range(12):
        blended = MATRIX + LANES * c
        for r in range(LANES):
            block[blended + r] = _ZERO
        for k in range(layout.keys):
            value, w = row[12 * k + c], KEYS + LANES * k
            for r in range(LANES):
                block[blended + r] += value * block[w + r]
    _meet_blended_gradients(row, d_row, layout, block)
    for k in range(layout.keys):
        w, d_w = KEYS + LANES * k, KEYS + LANES * (layout.keys + k)
        for c in range(12):
            value, g = row[12 * k + c], G_BLENDED + LANES * c
            d_row[12 * k + c] += _product_sum(block, w, g)
            for r in range(LANES):
                block[d_w + r] += value * block[g + r]


@summing_code
def _meet_blended_gradients(row, d_row, layout, block):
    """The gradients of each ray to the matrix and the mean that were blended for it."""
    velocity, instant, rate, plateau = _window_of(row, layout)
    vx, vy, vz, born, fades, lasts = _SIX_ZEROS
    for r in range(LANES):
        age = block[TIME + r] - instant
        a = inverse_of(
            (
                block[MATRIX + r],
                block[MATRIX + LANES + r],
                block[MATRIX + 2 * LANES + r],
                block[MATRIX + 3 * LANES + r],
                block[MATRIX + 4 * LANES + r],
                block[MATRIX + 5 * LANES + r],
                block[MATRIX + 6 * LANES + r],
                block[MATRIX + 7 * LANES + r],
                block[MATRIX + 8 * LANES + r],
            )
        )
        x = (
            block[_OX + r] - block[_MX + r] - age * velocity[0],
            block[_OY + r] - block[_MY + r] - age * velocity[1],
            block[_OZ + r] - block[_MZ + r] - age * velocity[2],
        )
        hit, g_q = block[WEIGHT + r] > _ZERO, block[G_Q + r]
        x, d = _where(hit, x), _where(hit, (block[_DX + r], block[_DY + r], block[_DZ + r]))
        g_a, g_x, g_d = _meeting_gradient(a, x, d, block[G_T + r], g_q)
        g_f = _gradient_of_inverse(a, g_a)
        g_age, g_rate, g_plateau = _window_gradient(age, velocity, rate, plateau, g_x, g_q)
        block[G_BLENDED + r] = g_f[0]
        block[G_BLENDED + LANES + r] = g_f[1]
        block[G_BLENDED + 2 * LANES + r] = g_f[2]
        block[G_BLENDED + 3 * LANES + r] = g_f[3]
        block[G_BLENDED + 4 * LANES + r] = g_f[4]
        block[G_BLENDED + 5 * LANES + r] = g_f[5]
        block[G_BLENDED + 6 * LANES + r] = g_f[6]
        block[G_BLENDED + 7 * LANES + r] = g_f[7]
        block[G_BLENDED + 8 * LANES + r] = g_f[8]
        block[G_BLENDED + 9 * LANES + r] = -g_x[0]
        block[G_BLENDED + 10 * LANES + r] = -g_x[1]
        block[G_BLENDED + 11 * LANES + r] = -g_x[2]
        vx, vy, vz = vx - age * g_x[0], vy - age * g_x[1], vz - age * g_x[2]
        born, fades, lasts = born - g_age, fades + g_rate, lasts + g_plateau
        block[_SUM_OX + r] += g_x[0]
        block[_SUM_OY + r] += g_x[1]
        block[_SUM_OZ + r] += g_x[2]
        block[_SUM_DX + r] += g_d[0]
        block[_SUM_DY + r] += g_d[1]
        block[_SUM_DZ + r] += g_d[2]
        block[D_TIME + r] += g_age
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
