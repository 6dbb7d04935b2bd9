"""One ray meets one Gaussian, in machine code for a CPU: the equations of table.py, response.py and
harmonics.py. Their derivatives are in cpu/gradient.py.

A row is one of `gaussian_table`; `layout` says what stands where in it. A ray is its origin o, unit
direction d, time, and the weights w of its control points.
"""

from typing import NamedTuple

import numpy as np

from gaussray.runtime.machine_code import machine_code
from gaussray.scene.harmonics import C0, C1, C2, C3


_ZERO, _ONE = np.float32(0), np.float32(1)
_TWO, _THREE, _FOUR = (np.float32(x) for x in (2, 3, 4))
_INFINITY = np.float32(np.inf)
_C0, _C1 = np.float32(C0), np.float32(C1)
_C2A, _C2B, _C2C = (np.float32(x) for x in C2)
_C3A, _C3B, _C3C, _C3D, _C3E = (np.float32(x) for x in C3)


class Layout(NamedTuple):
    """Columns of a row of `gaussian_table`.

    Args:
        keys: number of key states.
        coefficients: number of harmonics per channel.
        window: first column of the time window; -1 without one.
        opacity: column of the opacity.
        harmonics: first column of the harmonics.
        tint: first column of the tint; -1 without one.
    """

    keys: int
    coefficients: int
    window: int
    opacity: int
    harmonics: int
    tint: int


@machine_code
def meet_ray(a, m, o, d):
    """Distance t of the peak of a Gaussian along a ray, and the squared distance q there.

    In scene units and squared standard deviations; q is infinity for direction zero (`response`).

    Args:
        a: a = S^-1 R^T of the Gaussian, nine entries row by row.
        m: mean of the Gaussian, in scene units.
        o: origin of the ray, in scene units.
        d: unit direction of the ray.
    """
    x, y, z = o[0] - m[0], o[1] - m[1], o[2] - m[2]
    shift = -(x * d[0] + y * d[1] + z * d[2])
    px, py, pz = x + shift * d[0], y + shift * d[1], z + shift * d[2]
    ox = a[0] * px + a[1] * py + a[2] * pz
    oy = a[3] * px + a[4] * py + a[5] * pz
    oz = a[6] * px + a[7] * py + a[8] * pz
    vx = a[0] * d[0] + a[1] * d[1] + a[2] * d[2]
    vy = a[3] * d[0] + a[4] * d[1] + a[5] * d[2]
    vz = a[6] * d[0] + a[7] * d[1] + a[8] * d[2]
    square = vx * vx + vy * vy + vz * vz
    inverse = _ONE / (square if square > _ZERO else _ONE)
    cx, cy, cz = oy * vz - oz * vy, oz * vx - ox * vz, ox * vy - oy * vx
    t = shift - (ox * vx + oy * vy + oz * vz) * inverse
    q = (cx * cx + cy * cy + cz * cz) * inverse
    return t, q if square > _ZERO else _INFINITY


@machine_code
def time_distance(age, rate, plateau):
    """Distance in time from the plateau of a transient Gaussian, in lifetimes; 0 within it.

    Args:
        age: time since the Gaussian's instant, in the capture's unit; negative before it.
        rate: 1 / lifetime.
        plateau: half the time of full opacity.
    """
    beyond = abs(age) - plateau
    return (beyond if beyond > _ZERO else _ZERO) * rate


@machine_code
def inverse_of(f):
    """Inverse of a 3 x 3 matrix by cofactors, its columns first divided by their largest entry."""
    su = max(abs(f[0]), abs(f[3]), abs(f[6]))
    sv = max(abs(f[1]), abs(f[4]), abs(f[7]))
    sw = max(abs(f[2]), abs(f[5]), abs(f[8]))
    su = su if su > _ZERO else _ONE
    sv = sv if sv > _ZERO else _ONE
    sw = sw if sw > _ZERO else _ONE
    u = (f[0] / su, f[3] / su, f[6] / su)
    v = (f[1] / sv, f[4] / sv, f[7] / sv)
    w = (f[2] / sw, f[5] / sw, f[8] / sw)
    a, b, c = cross(v, w), cross(w, u), cross(u, v)
    determinant = dot(u, a)
    determinant = determinant if determinant != _ZERO else _ONE
    x, y, z = _ONE / (determinant * su), _ONE / (determinant * sv), _ONE / (determinant * sw)
    return (
        a[0] * x,
        a[1] * x,
        a[2] * x,
        b[0] * y,
        b[1] * y,
        b[2] * y,
        c[0] * z,
        c[1] * z,
        c[2] * z,
    )


@machine_code
def dot(a, b):
    """Inner product of two vectors.

    Args:
        a: three components.
        b: three components.
    """
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@machine_code
def cross(a, b):
    """Cross product a x b.

    Args:
        a: three components.
        b: three components.
    """
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@machine_code
def matrix_of(row):
    """The matrix of a row with one key state."""
    return row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8]


@machine_code
def harmonics_of(d, coefficients, y):
    """Compute the first harmonics of a direction (`harmonic_basis`).

    Args:
        d: unit direction of the ray, in world axes.
        coefficients: number of harmonics: 1, 4, 9 or 16.
        y: array that receives the harmonics; further elements stay as they are.
    """
    x, v, z = d
    y[0] = _C0
    if coefficients > 1:
        y[1], y[2], y[3] = -_C1 * v, _C1 * z, -_C1 * x
    if coefficients > 4:
        y[4], y[5], y[7] = _C2A * x * v, -_C2A * v * z, -_C2A * x * z
        y[6] = _C2B * (_TWO * z * z - x * x - v * v)
        y[8] = _C2C * (x * x - v * v)
    if coefficients > 9:
        y[9] = -_C3A * v * (_THREE * x * x - v * v)
        y[10] = _C3B * x * v * z
        y[11] = -_C3C * v * (_FOUR * z * z - x * x - v * v)
        y[12] = _C3D * z * (_TWO * z * z - _THREE * x * x - _THREE * v * v)
        y[13] = -_C3C * x * (_FOUR * z * z - x * x - v * v)
        y[14] = _C3E * z * (x * x - v * v)
        y[15] = -_C3A * x * (x * x - _THREE * v * v)
