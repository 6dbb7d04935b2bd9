"""Derivatives of what one ray sees of one Gaussian (cpu_hit.py), in machine code for a CPU.

`d_row` sums the gradients of a row, `d_ray` those of a ray: origin, direction, time, weights.
"""

import numpy as np

from gaussray.scene.harmonics import C1, C2, C3
from gaussray.tracer.cpu_call import inlined_code, machine_code
from gaussray.tracer.cpu_hit import clamp_positive, color_of, cross, dot, state_on_ray


_ZERO, _ONE, _TWO, _THREE = (np.float32(x) for x in (0, 1, 2, 3))
_FOUR, _SIX, _EIGHT = (np.float32(x) for x in (4, 6, 8))
_C1 = np.float32(C1)
_C2A, _C2B, _C2C = (np.float32(x) for x in C2)
_C3A, _C3B, _C3C, _C3D, _C3E = (np.float32(x) for x in C3)


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


@inlined_code
def add_color_gradient(row, d_row, layout, w, d_ray, y, d_y, g):
    """Add the gradients of a hit's tinted colour to those of its row, the ray and the harmonics.

    Args:
        row: row of the Gaussian.
        d_row: gradients of the row, to which is added.
        layout: columns of the row.
        w: weights of the control points on the ray.
        d_ray: gradients of the ray (origin, direction, time, weights), to which is added.
        y: harmonics of the ray's direction.
        d_y: gradients of the harmonics, to which is added.
        g: gradient of the loss with respect to the tinted colour.
    """
    color, tint = color_of(row, layout, w, y)
    cut = clamp_positive(tint)
    red = g[0] * cut[0] if color[0] > _ZERO else _ZERO
    green = g[1] * cut[1] if color[1] > _ZERO else _ZERO
    blue = g[2] * cut[2] if color[2] > _ZERO else _ZERO
    at = layout.harmonics
    for k in range(layout.coefficients):
        d_row[at] += y[k] * red
        d_row[at + 1] += y[k] * green
        d_row[at + 2] += y[k] * blue
        d_y[k] += row[at] * red + row[at + 1] * green + row[at + 2] * blue
        at += 3
    if layout.tint >= 0:
        radiance = clamp_positive(color)
        for c in range(3):
            if tint[c] > _ZERO:
                d_tint = g[c] * radiance[c]
                for k in range(layout.keys):
                    at = layout.tint + 3 * k + c
                    d_row[at] += w[k] * d_tint
                    d_ray[7 + k] += row[at] * d_tint


@inlined_code
def add_meeting_gradient(row, d_row, layout, ray, w, d_ray, g_t, g_q):
    """Add the gradients of a hit's distances t and q to those of the Gaussian's row and the ray.

    Args:
        row: row of the Gaussian.
        d_row: gradients of the row, to which is added.
        layout: columns of the row.
        ray: origin, unit direction and time of the ray.
        w: weights of the control points on the ray.
        d_ray: gradients of the ray (origin, direction, time, weights), to which is added.
        g_t: gradient of the loss with respect to the distance t along the ray.
        g_q: gradient with respect to the squared distance q from the Gaussian.
    """
    o, d, time = ray
    a, m, age = state_on_ray(row, layout, w, time)
    x = (o[0] - m[0], o[1] - m[1], o[2] - m[2])
    shift = -dot(x, d)
    p = (x[0] + shift * d[0], x[1] + shift * d[1], x[2] + shift * d[2])
    u = (dot(a[0:3], p), dot(a[3:6], p), dot(a[6:9], p))
    v = (dot(a[0:3], d), dot(a[3:6], d), dot(a[6:9], d))
    square = dot(v, v)
    if not square > _ZERO:
        return
    inverse = _ONE / square
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
    for k in range(3):
        d_ray[k] += g_x[k]
        d_ray[3 + k] += g_d[k] + shift * g_p[k] - g_shift * x[k]
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
    g_m = (-g_x[0], -g_x[1], -g_x[2])
    if layout.window >= 0:
        _add_window_gradient(row, d_row, layout, d_ray, age, g_m, g_q)
    if layout.keys == 1:
        for k in range(9):
            d_row[k] += g_a[k]
        for k in range(3):
            d_row[9 + k] += g_m[k]
        return
    g_f = _gradient_of_inverse(a, g_a)
    for key in range(layout.keys):
        weight, at, d_w = w[key], 12 * key, _ZERO
        for k in range(9):
            d_row[at + k] += weight * g_f[k]
            d_w += row[at + k] * g_f[k]
        for k in range(3):
            d_row[at + 9 + k] += weight * g_m[k]
            d_w += row[at + 9 + k] * g_m[k]
        d_ray[7 + key] += d_w


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


@inlined_code
def _add_window_gradient(row, d_row, layout, d_ray, age, g_m, g_q):
    """Add the gradients of a transient Gaussian's motion and window."""
    w = layout.window
    g_age = g_m[0] * row[w] + g_m[1] * row[w + 1] + g_m[2] * row[w + 2]
    rate = row[w + 4]
    beyond = abs(age) - row[w + 5]
    if beyond > _ZERO:
        slope = _TWO * g_q * beyond * rate
        g_age += slope * rate if age > _ZERO else -slope * rate
        d_row[w + 4] += slope * beyond
        d_row[w + 5] -= slope * rate
    for k in range(3):
        d_row[w + k] += age * g_m[k]
    d_row[w + 3] -= g_age
    d_ray[6] += g_age
