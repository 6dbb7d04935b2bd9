"""Which ellipsoids a cone around a bundle of rays misses, in machine code for a CPU.

A long ellipsoid may reach into all half-spaces of a bundle and still pass it by. A cone with four
edges a_1 ... a_4 from an apex holds all rays of the bundle. With F the frame of an ellipsoid, its
columns as long as its semi-axes, and c its centre seen from the apex, the ray of direction d meets
it, or its mirror image behind the apex, where

    Q(d) = |cof(F)^T d|^2 - |F^T (c x d)|^2 >= 0,

cof(F) the cofactors. The directions of Q >= 0 are a convex cone and its mirror image. So the cone
of the bundle misses them if Q is negative on its edges and on the faces between two of them, and c
is not inside.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.geometry import normalize
from gaussray.runtime.machine_code import inlined_code, machine_code
from gaussray.tracer.bundle import Bundles
from gaussray.tracer.cpu.reach import SLACK


# The sides of a bundle that meet in each edge: low and high of u, then of v (`bound_bundles`).
_AROUND = ((0, 2), (1, 2), (1, 3), (0, 3))
# F^T (c x d) is known to within e = 1e-6 |F| |c|, so that its square p is above (1 - r) p - e^2 / r
# for any r: _RELATIVE is r, and _ABSOLUTE is e^2 / r, in (|F| |c|)^2.
_RELATIVE, _ABSOLUTE = np.float32(1e-3), np.float32(1e-9)
_ZERO, _ONE = np.float32(0), np.float32(1)


def bounding_cones(bundles: Bundles) -> Float[Array, "bundles numbers"]:
    """A cone that holds the rays of each bundle: apex, then four unit edges in a circle; edges of
    zero where there is no such cone.

    The planes of the bundle's sides, moved together to one apex, which lies on the bundle's near
    plane if all its rays begin at one point, and behind it otherwise.
    """
    axis, sides = bundles.normal[:, 0], bundles.normal[:, 1:]
    toward = jnp.sum(sides * axis[:, None], axis=-1)
    across = sides - toward[..., None] * axis[:, None]
    length = jnp.linalg.norm(across, axis=-1)
    closed = jnp.all(length > 0, axis=-1) & jnp.all(toward > 0, axis=-1)
    length = jnp.where(length > 0, length, 1)
    # The plane of a side: u, or v, is its slope times the depth along the axis, plus `rest`.
    sign = jnp.asarray([1, -1, 1, -1], axis.dtype)
    unit = sign[None, :, None] * across / length[..., None]
    slope = -sign[None] * toward / length
    rest = sign[None] * bundles.offset[:, 1:] / length
    depth = bundles.offset[:, 0]
    at = slope * depth[:, None] + rest
    u, v = unit[:, 0], unit[:, 2]
    apex = depth[:, None] * axis + at[:, 0, None] * u + at[:, 2, None] * v
    slack = 8 * SLACK * jnp.sum(jnp.abs(apex), axis=-1, keepdims=True)
    beyond = jnp.sum(sides * apex[:, None], axis=-1) - bundles.offset[:, 1:] + slack
    back = jnp.max(beyond / jnp.where(toward > 0, toward, 1), axis=-1)
    apex = apex - jnp.maximum(back, 0)[:, None] * axis
    edges = jnp.stack(
        [axis + slope[:, i, None] * u + slope[:, j, None] * v for i, j in _AROUND], axis=1
    )
    closed = closed & jnp.all(jnp.isfinite(apex), axis=-1)
    edges = jnp.where(closed[:, None, None], normalize(edges), 0)
    apex = jnp.where(closed[:, None], apex, 0)
    return jnp.concatenate([apex, edges.reshape(-1, 12)], axis=1)


@inlined_code
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inlined_code
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined_code
def _parts(g, h, edge):
    """F^T (c x a) and cof(F)^T a of an edge a."""
    return (
        (_dot(g[0], edge), _dot(g[1], edge), _dot(g[2], edge)),
        (_dot(h[0], edge), _dot(h[1], edge), _dot(h[2], edge)),
    )


@inlined_code
def _clears(one, other, tiny):
    """Whether Q is negative between two edges, as on them, with room for rounding."""
    p, q, across = _dot(one[0], one[0]), _dot(other[0], other[0]), _dot(one[0], other[0])
    first = p - _dot(one[1], one[1]) - _RELATIVE * p - tiny
    last = q - _dot(other[1], other[1]) - _RELATIVE * q - tiny
    mixed = _dot(one[1], other[1]) - across + _RELATIVE * (p + q) + tiny
    between = (mixed <= _ZERO) | (mixed * mixed < first * last)
    return (first > _ZERO) & (last > _ZERO) & between


@machine_code
def drop_missed(rows, count, cone, room):
    """Make `room` negative for ellipsoids that a cone misses.

    Args:
        rows: rows of the states of one control point (`STATE_ROWS`).
        count: number of ellipsoids.
        cone: numbers of the cone (`bounding_cones`).
        room: negative for ellipsoids that are outside already.
    """
    a1, a2 = (cone[3], cone[4], cone[5]), (cone[6], cone[7], cone[8])
    a3, a4 = (cone[9], cone[10], cone[11]), (cone[12], cone[13], cone[14])
    # Inner normals of the faces.
    n1, n2 = _cross(*a1, *a2), _cross(*a2, *a3)
    n3, n4 = _cross(*a3, *a4), _cross(*a4, *a1)
    turn = _ONE if _dot(n1, a3) > _ZERO else -_ONE
    for i in range(count):
        x, y, z = rows[0, i] - cone[0], rows[1, i] - cone[1], rows[2, i] - cone[2]
        f1 = rows[3, i], rows[4, i], rows[5, i]
        f2 = rows[6, i], rows[7, i], rows[8, i]
        f3 = rows[9, i], rows[10, i], rows[11, i]
        c = x, y, z
        g = _cross(*f1, *c), _cross(*f2, *c), _cross(*f3, *c)
        h = _cross(*f2, *f3), _cross(*f3, *f1), _cross(*f1, *f2)
        tiny = _ABSOLUTE * (_dot(f1, f1) + _dot(f2, f2) + _dot(f3, f3)) * _dot(c, c)
        e1, e2, e3, e4 = _parts(g, h, a1), _parts(g, h, a2), _parts(g, h, a3), _parts(g, h, a4)
        inside = (turn * _dot(n1, c) >= _ZERO) & (turn * _dot(n2, c) >= _ZERO)
        inside = inside & (turn * _dot(n3, c) >= _ZERO) & (turn * _dot(n4, c) >= _ZERO)
        clear = _clears(e1, e2, tiny) & _clears(e2, e3, tiny)
        clear = clear & _clears(e3, e4, tiny) & _clears(e4, e1, tiny)
        room[i] = -_ONE if clear & (not inside) else room[i]
