"""Which Gaussians reach into all half-spaces of a bundle of rays, in machine code for a CPU.

Gaussians stand side by side, each row of an array holding one number of all: so the compiler turns
loops over them into vector instructions. A transient one counts where it is during the bundle's
time, as far as it has not faded (`window.swept_between`).
"""

from typing import Any, NamedTuple

import numpy as np

from gaussray.runtime.machine_code import inlined_code, machine_code


_ZERO, _ONE, _FAR = np.float32(0), np.float32(1), np.float32(np.inf)
# Rounding of sums of few numbers, relative to the largest.
SLACK = np.float32(1e-6)
_SQUARED_SLACK = np.float32(4e-6)
# Gaussians that are tested at a time: as vectors, and in the nearest cache.
TESTED_AT_ONCE = 512
# Rows of a sphere: centre and radius. Of what is known of a Gaussian at a control point: centre,
# and F^T times its reach.
SPHERE_ROWS, STATE_ROWS = 4, 12
# Rows of a time window behind these: velocity, instant, how long before and after it the Gaussian
# is alive, plateau, and how fast it fades: (1 / lifetime) / reach.
WINDOW_ROWS = 7


class Sides(NamedTuple):
    """Bounds of bundles, as operands.

    Args:
        normal: normals of the five half-spaces, (bundles, 15).
        offset: their offsets, (bundles, 5).
        active: 1 for the control points that the bundle's times touch, (bundles, keys).
        span: first and last time of the rays, within the motion's range of time, (bundles, 2).
    """

    normal: Any
    offset: Any
    active: Any
    span: Any


class Work(NamedTuple):
    """Buffers of a thread, of `TESTED_AT_ONCE` numbers each.

    Args:
        room: how far each Gaussian reaches into the half-spaces; negative for those outside.
        first: time from its instant to the beginning of the bundle's, within its life.
        last: time to the end of the bundle's.
        shrink: square of how much smaller its ellipsoid is than at full opacity.
        least: how far the half-space is from its way.
        best: how far it reaches into one half-space.
    """

    room: Any
    first: Any
    last: Any
    shrink: Any
    least: Any
    best: Any


@inlined_code
def _side(sides, bundle, n):
    """Normal and offset of a half-space."""
    at = 3 * n
    return (
        sides.normal[bundle, at],
        sides.normal[bundle, at + 1],
        sides.normal[bundle, at + 2],
        sides.offset[bundle, n],
    )


@inlined_code
def _along(side, x, y, z):
    return side[0] * x + side[1] * y + side[2] * z


@machine_code
def _sweep(rows, w, begin, count, span, work):
    """Where transient Gaussians are during a time, and how far they have faded: `first`, `last` and
    `shrink`, which is negative for those that are not alive."""
    instant, length, plateau, fade = rows[w + 3], rows[w + 4], rows[w + 5], rows[w + 6]
    first, last, shrink = work.first, work.last, work.shrink
    earliest, latest = span
    for i in range(count):
        g = begin + i
        a, b, reach = earliest - instant[g], latest - instant[g], length[g]
        beyond = max(max(a, -b), _ZERO) - plateau[g]
        s = max(beyond, _ZERO) * fade[g]
        first[i], last[i] = min(max(a, -reach), reach), min(max(b, -reach), reach)
        # Rounding must not cut off what a ray at the very end still meets.
        shrink[i] = min(_ONE + _SQUARED_SLACK - s * s, _ONE) if a <= b else -_ONE


@machine_code
def _begin_test(rows, w, begin, count, span, work):
    """Prepare a test of Gaussians, whose time windows, if any, begin at row `w`: all are inside as
    yet, but those that are not alive."""
    room, first, last, shrink = work.room, work.first, work.last, work.shrink
    if rows.shape[0] > w:
        _sweep(rows, w, begin, count, span, work)
        for i in range(count):
            room[i] = _FAR if shrink[i] > _ZERO else -_ONE
    else:
        for i in range(count):
            room[i], first[i], last[i], shrink[i] = _FAR, _ZERO, _ZERO, _ONE


@machine_code
def _approach(rows, w, begin, count, side, work):
    """Store in `least` how far a half-space is from where Gaussians stand at their instants, at the
    nearest place of their way."""
    first, last, least, offset = work.first, work.last, work.least, side[3]
    if rows.shape[0] > w:
        u, v, z = rows[w], rows[w + 1], rows[w + 2]
        for i in range(count):
            speed = _along(side, u[begin + i], v[begin + i], z[begin + i])
            least[i] = offset - max(speed * first[i], speed * last[i])
    else:
        for i in range(count):
            least[i] = offset


@machine_code
def spheres_inside(rows, count, sides, bundle, kept, work):
    """Write the numbers of the spheres that reach into all half-spaces of a bundle to `kept`, and
    return how many they are.

    Args:
        rows: rows of the spheres, and of their time windows if there are more than `SPHERE_ROWS`.
        count: number of spheres.
        sides: bounds of bundles.
        bundle: index of the bundle.
        kept: room for one number more than there are spheres.
        work: buffers of the thread.
    """
    x, y, z, size, length = rows[0], rows[1], rows[2], rows[3], 0
    room, least, span = work.room, work.least, (sides.span[bundle, 0], sides.span[bundle, 1])
    for begin in range(0, count, TESTED_AT_ONCE):
        run = min(TESTED_AT_ONCE, count - begin)
        _begin_test(rows, SPHERE_ROWS, begin, run, span, work)
        for n in range(5):
            side = _side(sides, bundle, n)
            _approach(rows, SPHERE_ROWS, begin, run, side, work)
            for i in range(run):
                g = begin + i
                inside = _along(side, x[g], y[g], z[g]) + size[g] - least[i]
                room[i] = min(room[i], inside)
        for i in range(run):
            kept[length] = begin + i
            length += not room[i] < _ZERO
    return length


@machine_code
def ellipsoids_inside(rows, count, keys, sides, bundle, work):
    """Store in `room` whether ellipsoids reach into all half-spaces of a bundle, at some of the
    control points that its times touch; it is negative for those that do not.

    Args:
        rows: rows of the states of each control point, then of the time windows of transient ones.
        count: number of ellipsoids, at most `TESTED_AT_ONCE`.
        keys: number of control points.
        sides: bounds of bundles.
        bundle: index of the bundle.
        work: buffers of the thread.
    """
    room, best, w = work.room, work.best, STATE_ROWS * keys
    _begin_test(rows, w, 0, count, (sides.span[bundle, 0], sides.span[bundle, 1]), work)
    for n in range(5):
        side = _side(sides, bundle, n)
        _approach(rows, w, 0, count, side, work)
        for i in range(count):
            best[i] = -_ONE
        for k in range(keys):
            # Transient ones have a single state, whatever the others have.
            if rows.shape[0] > w or sides.active[bundle, k] > _ZERO:
                _reach_side(rows, STATE_ROWS * k, count, side, work)
        for i in range(count):
            room[i] = min(room[i], best[i])


@machine_code
def _reach_side(rows, c, count, side, work):
    """Raise `best` to how far the ellipsoids of a control point reach into a half-space."""
    shrink, least, best = work.shrink, work.least, work.best
    x, y, z = rows[c], rows[c + 1], rows[c + 2]
    x1, y1, z1 = rows[c + 3], rows[c + 4], rows[c + 5]
    x2, y2, z2 = rows[c + 6], rows[c + 7], rows[c + 8]
    x3, y3, z3 = rows[c + 9], rows[c + 10], rows[c + 11]
    for i in range(count):
        along = _along(side, x[i], y[i], z[i])
        one = _along(side, x1[i], y1[i], z1[i])
        two = _along(side, x2[i], y2[i], z2[i])
        three = _along(side, x3[i], y3[i], z3[i])
        squared = (one * one + two * two + three * three) * shrink[i]
        # Its height above the centre is the root of `squared`; it has to bridge `gap`, if any.
        gap = least[i] - along - SLACK * (abs(along) + abs(least[i]))
        inside = squared * (_ONE + _SQUARED_SLACK) - gap * abs(gap)
        best[i] = max(best[i], inside)
