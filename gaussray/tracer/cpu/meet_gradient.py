"""Derivatives of how one ray meets one Gaussian (cpu/hit.py), in machine code for a CPU."""

import numpy as np

from gaussray.runtime.machine_code import inlined_code, machine_code
from gaussray.tracer.cpu.block import (
    AT_D_DIRECTION,
    AT_D_ORIGIN,
    AT_D_TIME,
    AT_DIRECTION,
    AT_ORIGIN,
    AT_WEIGHT,
    LANES,
)
from gaussray.tracer.cpu.hit import cross, dot


_ZERO, _ONE, _TWO = (np.float32(x) for x in (0, 1, 2))


def _three(first: int) -> tuple[int, int, int]:
    return first, first + LANES, first + 2 * LANES


_OX, _OY, _OZ = _three(AT_ORIGIN)
_DX, _DY, _DZ = _three(AT_DIRECTION)
_SUM_OX, _SUM_OY, _SUM_OZ = _three(AT_D_ORIGIN)
_SUM_DX, _SUM_DY, _SUM_DZ = _three(AT_D_DIRECTION)


@inlined_code
def hit_of(block, r, mean, velocity, age):
    """Origin of a ray from the mean of a Gaussian, and its direction: zero where the ray does not
    hit the Gaussian, since there numbers may be too large.

    Args:
        block: the block.
        r: lane of the ray.
        mean: of the Gaussian, at its own instant.
        velocity: of the Gaussian.
        age: time of the ray, from that instant on.
    """
    hit = block[AT_WEIGHT + r] > _ZERO
    x = block[_OX + r] - (mean[0] + age * velocity[0])
    y = block[_OY + r] - (mean[1] + age * velocity[1])
    z = block[_OZ + r] - (mean[2] + age * velocity[2])
    dx, dy, dz = block[_DX + r], block[_DY + r], block[_DZ + r]
    place = (x if hit else _ZERO, y if hit else _ZERO, z if hit else _ZERO)
    return place, (dx if hit else _ZERO, dy if hit else _ZERO, dz if hit else _ZERO)


@inlined_code
def add_ray_gradient(block, r, g_x, g_d, g_age):
    """Add the gradients of a ray's origin, direction and time.

    Args:
        block: the block.
        r: lane of the ray.
        g_x: gradient to its origin.
        g_d: gradient to its direction.
        g_age: gradient to its time.
    """
    block[_SUM_OX + r] += g_x[0]
    block[_SUM_OY + r] += g_x[1]
    block[_SUM_OZ + r] += g_x[2]
    block[_SUM_DX + r] += g_d[0]
    block[_SUM_DY + r] += g_d[1]
    block[_SUM_DZ + r] += g_d[2]
    block[AT_D_TIME + r] += g_age


@inlined_code
def meeting_gradient(a, x, d, g_t, g_q):
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
    g_p = transposed(a, g_u)
    g_d = transposed(a, g_v)
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
def window_gradient(age, v, rate, plateau, g_x, g_q):
    """Gradients of a transient Gaussian's motion and window: to the age, 1 / lifetime, plateau.

    Args:
        age: time of the ray, from the Gaussian's instant on.
        v: velocity of the Gaussian.
        rate: 1 / lifetime.
        plateau: half of the time over which it does not fade.
        g_x: gradient to the ray's origin from the mean.
        g_q: gradient to the squared distance q.
    """
    beyond = abs(age) - plateau
    slope = _TWO * g_q * beyond * rate if beyond > _ZERO else _ZERO
    g_age = -dot(g_x, v) + (slope * rate if age > _ZERO else -slope * rate)
    return g_age, slope * beyond, -slope * rate


@inlined_code
def window_of(row, layout):
    """Velocity, instant, 1 / lifetime and plateau; a Gaussian without window stands still.

    Args:
        row: row of the Gaussian.
        layout: columns of the row.
    """
    if layout.window >= 0:
        w = layout.window
        return (row[w], row[w + 1], row[w + 2]), row[w + 3], row[w + 4], row[w + 5]
    return (_ZERO, _ZERO, _ZERO), _ZERO, _ZERO, _ZERO


@machine_code
def transposed(a, v):
    """The transpose of a matrix times a vector.

    Args:
        a: the nine numbers of the matrix, row by row.
        v: the vector.
    """
    return (
        a[0] * v[0] + a[3] * v[1] + a[6] * v[2],
        a[1] * v[0] + a[4] * v[1] + a[7] * v[2],
        a[2] * v[0] + a[5] * v[1] + a[8] * v[2],
    )
