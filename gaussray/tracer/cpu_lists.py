"""Candidate lists of few bundles on a CPU, in machine code: every coarse bundle looks at all
Gaussians, and its own bundles at those that it keeps. Nothing is sorted."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.tracer.bundle import Bundles
from gaussray.tracer.cpu_call import (
    allocating_code,
    call_frame,
    entry_address,
    floats,
    integers,
    is_execution,
    join_threads,
    machine_code,
    next_piece,
    operand,
    register,
    result,
    shared_address,
    shared_state,
    start_threads,
    thread_count,
)
from gaussray.tracer.motion import Motion, clipped_time, control_points, is_valid
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.response import reach_radius
from gaussray.tracer.traverse import Candidates, Capacity
from gaussray.tracer.window import all_states, swept_between


_LISTS = "gaussray_candidate_lists"
# Rounding of sums of few numbers, relative to the largest.
_SLACK = np.float32(1e-6)
# Spheres that are tested before those that pass are noted: as vectors, and in the nearest cache.
_RUN = 1024


class _Shapes(NamedTuple):
    """Gaussians as the call reads them.

    Args:
        sphere: centre and radius of a sphere around the ellipsoid at all control points and times,
            (4, Gaussians); a radius of minus infinity keeps a Gaussian out of all lists.
        row: of each Gaussian for each control point the centre and F^T times the reach, row after
            row; then the ways from the centre to the places at the first and at the last time, and
            the factor by which the ellipsoid shrinks, (Gaussians, 12 keys + 7).
    """

    sphere: Float[Array, "4 gaussians"]
    row: Float[Array, "gaussians columns"]


def find_lists(
    motion: Motion,
    levels: list[Bundles],
    span: Float[Array, "2"],
    *,
    options: TraceOptions,
    capacity: Capacity,
) -> tuple[Candidates, Int[Array, ""]]:
    """The lists of all bundles, and how many Gaussians are not finite. No gradient.

    A list holds the Gaussians whose ellipsoid reaches into all half-spaces of the bundle at some
    control point that is active in its time (`traverse`); transient ones at some time of all rays.
    They come in their own order.

    Args:
        motion: the scene, without Gaussians apart (`merge_rest`).
        levels: bundles from the coarsest level to the finest; at most two are looked at.
        span: first and last time of all rays.
        options: how rays are traced.
        capacity: sizes of the lists.
    """
    register_lists()
    shapes, invalid = _shapes(motion, span, options.alpha_min)
    fine, coarse = levels[-1], levels[-2] if len(levels) > 1 else levels[-1]
    bundles, slots = fine.offset.shape[0], capacity.slots
    call = jax.ffi.ffi_call(
        _LISTS,
        tuple(
            jax.ShapeDtypeStruct(shape, np.int32)
            for shape in ((capacity.pairs,), (bundles,), (bundles,), (3,), (bundles, slots))
        ),
        vmap_method="sequential",
    )
    numbers = np.asarray([thread_count(), bundles // coarse.offset.shape[0]], np.int32)
    index, start, count, sizes, _ = call(*shapes, *_sides(fine), *_sides(coarse), numbers)
    pairs, longest, lost = sizes
    return Candidates(index, start, count, jnp.stack([pairs, longest]), lost), invalid


def _shapes(
    motion: Motion, span: Float[Array, "2"], alpha_min: float
) -> tuple[_Shapes, Int[Array, ""]]:
    """The Gaussians of a scene, and how many of them are not finite."""
    g, window = all_states(motion)
    mean, frame = control_points(Motion(motion.time, g))
    radius, fine = reach_radius(g.opacity, alpha_min), is_valid(g)
    keys, count = mean.shape[:2]
    support = frame * radius[None, :, None, None]
    if keys == 1:
        longest = radius[None] * jnp.max(g.scale, axis=-1)
    else:
        # Control points between keys have axes of any length and angle.
        longest = jnp.sqrt(jnp.sum(support * support, axis=(-2, -1)))
    first = last = jnp.zeros((count, 3), mean.dtype)
    shrink, included = jnp.ones(count, mean.dtype), fine & (radius > 0)
    if window is not None:
        earliest, latest = clipped_time(motion.time_range, span)
        swept = swept_between(window, radius, earliest, latest)
        first, last, shrink = swept.first, swept.last, swept.shrink
        included = included & (shrink > 0)
    low = [jnp.min(mean[..., i], axis=0) + jnp.minimum(first[:, i], last[:, i]) for i in range(3)]
    high = [jnp.max(mean[..., i], axis=0) + jnp.maximum(first[:, i], last[:, i]) for i in range(3)]
    middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    way = jnp.sqrt(sum((b - a) ** 2 for a, b in zip(low, high, strict=True))) / 2
    slack = _SLACK * sum(jnp.abs(x) for x in (*low, *high))
    size = (jnp.max(longest, axis=0) * shrink + way) * (1 + _SLACK) + slack
    sphere = jnp.stack([*middle, jnp.where(included, size, -jnp.inf)])
    turned = jnp.swapaxes(support, -2, -1).reshape(keys, count, 9)
    shapes = [part for k in range(keys) for part in (mean[k], turned[k])]
    row = jnp.concatenate([*shapes, first, last, shrink[:, None]], axis=1)
    return _Shapes(sphere, row), jnp.sum(~fine, dtype=jnp.int32)


def _sides(bundles: Bundles) -> tuple[Array, Array, Array]:
    """Half-spaces and active control points of bundles, as operands."""
    count = bundles.offset.shape[0]
    return bundles.normal.reshape(count, 15), bundles.offset, bundles.active.astype(jnp.float32)


class _Bounds(NamedTuple):
    """Operands of a call: half-spaces of bundles, and their active control points."""

    normal: Any
    offset: Any
    active: Any


@allocating_code
def _bounds_of(frame, first):
    return _Bounds(
        floats(operand(frame, first)),
        floats(operand(frame, first + 1)),
        floats(operand(frame, first + 2)),
    )


@allocating_code
def _spheres_inside(sphere, count, bounds, bundle, kept):
    """The spheres that reach into all half-spaces of a bundle: their numbers are written to `kept`,
    and how many they are is returned."""
    n, o = bounds.normal[bundle], bounds.offset[bundle]
    x0, y0, z0, x1, y1, z1, x2, y2, z2 = n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7], n[8]
    x3, y3, z3, x4, y4, z4 = n[9], n[10], n[11], n[12], n[13], n[14]
    o0, o1, o2, o3, o4 = o[0], o[1], o[2], o[3], o[4]
    x, y, z, size = sphere[0], sphere[1], sphere[2], sphere[3]
    room, length = np.empty(_RUN, np.float32), 0
    for begin in range(0, count, _RUN):
        run = min(_RUN, count - begin)
        for i in range(run):
            g = begin + i
            least = x0 * x[g] + y0 * y[g] + z0 * z[g] - o0
            least = min(least, x1 * x[g] + y1 * y[g] + z1 * z[g] - o1)
            least = min(least, x2 * x[g] + y2 * y[g] + z2 * z[g] - o2)
            least = min(least, x3 * x[g] + y3 * y[g] + z3 * z[g] - o3)
            least = min(least, x4 * x[g] + y4 * y[g] + z4 * z[g] - o4)
            room[i] = least + size[g]
        for i in range(run):
            kept[length] = begin + i
            length += room[i] >= 0
    return length


@machine_code
def _reaches_inside(row, keys, bounds, bundle):
    """Whether an ellipsoid reaches into all half-spaces of a bundle."""
    way = 12 * keys
    shrink = row[way + 6]
    for side in range(5):
        x, y, z = (
            bounds.normal[bundle, 3 * side],
            bounds.normal[bundle, 3 * side + 1],
            bounds.normal[bundle, 3 * side + 2],
        )
        first = x * row[way] + y * row[way + 1] + z * row[way + 2]
        last = x * row[way + 3] + y * row[way + 4] + z * row[way + 5]
        least = bounds.offset[bundle, side] - max(first, last)
        touches = False
        for k in range(keys):
            if bounds.active[bundle, k] == 0:
                continue
            c = 12 * k
            along = x * row[c] + y * row[c + 1] + z * row[c + 2]
            one = x * row[c + 3] + y * row[c + 4] + z * row[c + 5]
            two = x * row[c + 6] + y * row[c + 7] + z * row[c + 8]
            three = x * row[c + 9] + y * row[c + 10] + z * row[c + 11]
            height = math.sqrt(one * one + two * two + three * three) * shrink
            slack = _SLACK * (abs(along) + height + abs(least))
            touches = touches or along + height + slack >= least
        if not touches:
            return False
    return True


@allocating_code
def _list_bundles(shared):
    """Fill the places of the bundles of all coarse bundles that no other thread takes."""
    frame = call_frame(shared)
    sphere, rows = floats(operand(frame, 0)), floats(operand(frame, 1))
    fine, coarse = _bounds_of(frame, 2), _bounds_of(frame, 5)
    fan, keys = integers(operand(frame, 8))[1], fine.active.shape[1]
    count, places = integers(result(frame, 2)), integers(result(frame, 4))
    bundles, gaussians = len(count), sphere.shape[1]
    slots = len(places) // max(bundles, 1)
    # One place more: the number of what is not kept is written, too.
    kept, inside = np.empty(gaussians + 1, np.int32), np.empty(gaussians + 1, np.int32)
    near = np.empty((4, gaussians), np.float32)
    while True:
        parent = next_piece(shared)
        if parent * fan >= bundles:
            return
        length = _spheres_inside(sphere, gaussians, coarse, parent, kept)
        for c in range(4):
            for i in range(length):
                near[c, i] = sphere[c, kept[i]]
        for bundle in range(parent * fan, parent * fan + fan):
            met, begin = 0, bundle * slots
            for i in range(_spheres_inside(near, length, fine, bundle, inside)):
                g = kept[inside[i]]
                if _reaches_inside(rows[g], keys, fine, bundle):
                    if met < slots:
                        places[begin + met] = g
                    met += 1
            count[bundle] = met


@allocating_code
def _join_lists(frame):
    """The lists one after another, and the sizes that they need."""
    index, start, count = (
        integers(result(frame, 0)),
        integers(result(frame, 1)),
        integers(result(frame, 2)),
    )
    sizes, places = integers(result(frame, 3)), integers(result(frame, 4))
    slots = len(places) // max(len(count), 1)
    index[:] = -1
    total, longest, lost, filled = 0, 0, 0, 0
    for bundle in range(len(count)):
        wanted = count[bundle]
        total += wanted
        longest = max(longest, wanted)
        there = min(wanted, slots, len(index) - filled)
        start[bundle] = filled
        for i in range(there):
            index[filled + i] = places[bundle * slots + i]
        count[bundle] = there
        filled += there
        lost += wanted - there
    sizes[0], sizes[1], sizes[2] = total, longest, lost


@allocating_code
def _extra_threads(frame):
    """Threads to start beside the caller's."""
    number = integers(operand(frame, 8))
    pieces = len(integers(result(frame, 2))) // number[1]
    return max(min(np.int64(number[0]), pieces), 1) - 1


def _find(argument):
    shared = shared_address(argument)
    if shared:
        _list_bundles(shared)
    elif is_execution(argument):
        common = shared_state(argument)
        address = np.int64(common.ctypes.data)
        others = start_threads(entry_address(), address, _extra_threads(argument))
        _list_bundles(address)
        join_threads(others, common)
        _join_lists(argument)
    return 0


def register_lists() -> None:
    """Make the search known to XLA (`register`)."""
    register(_LISTS, _find)
