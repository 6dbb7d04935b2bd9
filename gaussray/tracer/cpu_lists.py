"""Candidate lists on a CPU, in machine code: every coarsest bundle looks at all Gaussians, and its
own bundles at those that it keeps. Nothing is sorted."""

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
    take_places,
    thread_count,
)
from gaussray.tracer.cpu_reach import (
    SLACK,
    SPHERE_ROWS,
    STATE_ROWS,
    TESTED_AT_ONCE,
    WINDOW_ROWS,
    Sides,
    Work,
    ellipsoids_inside,
    spheres_inside,
)
from gaussray.tracer.motion import Motion, clipped_time, control_points, is_valid, still
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.response import reach_radius
from gaussray.tracer.traverse import Candidates, Capacity
from gaussray.tracer.window import time_window_of


_LISTS = "gaussray_candidate_lists"
# Places for the list of a bundle, at first.
_PLACES = 256


class _Shapes(NamedTuple):
    """Gaussians as the call reads them: those that are there all the time, then transient ones.

    Args:
        sphere: centre and radius of a sphere around the ellipsoid at all control points, number by
            number; a radius of minus infinity keeps a Gaussian out of all lists. Of transient
            ones around the ellipsoid at its instant, with their time windows (cpu_reach.py).
        row: of each Gaussian the centre and F^T times the reach for each control point, Gaussian by
            Gaussian; of transient ones for the only one, and the time window.
    """

    sphere: Float[Array, "numbers gaussians"]
    row: Float[Array, "gaussians numbers"]


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
    control point that is active in its time (`traverse`). They come in their own order.

    Args:
        motion: the scene, without Gaussians apart (`merge_rest`).
        levels: bundles from the coarsest level to the finest; `CPU_LEVELS` coarser ones at most
            are looked at.
        span: first and last time of all rays.
        options: how rays are traced.
        capacity: sizes of the lists.
    """
    register_lists()
    persistent, invalid = _persistent_shapes(motion, options.alpha_min)
    transient, unusable = _transient_shapes(motion, span, options.alpha_min)
    fine = levels[-1]
    coarse = levels[-2] if len(levels) > 1 else fine
    coarsest = levels[-3] if len(levels) > 2 else coarse
    bundles = fine.offset.shape[0]
    call = jax.ffi.ffi_call(
        _LISTS,
        tuple(
            jax.ShapeDtypeStruct(shape, np.int32)
            for shape in ((capacity.pairs,), (bundles,), (bundles,), (3,))
        ),
        vmap_method="sequential",
    )
    bounds = [x for level in (fine, coarse, coarsest) for x in _sides(level, motion.time_range)]
    numbers = np.asarray([thread_count(), capacity.slots], np.int32)
    index, start, count, sizes = call(*persistent, *transient, *bounds, numbers)
    pairs, longest, lost = sizes
    return Candidates(index, start, count, jnp.stack([pairs, longest]), lost), invalid + unusable


def _persistent_shapes(motion: Motion, alpha_min: float) -> tuple[_Shapes, Int[Array, ""]]:
    """Gaussians that are there all the time, and how many of them are not finite."""
    g = motion.gaussians
    mean, frame = control_points(motion)
    radius, fine = reach_radius(g.opacity, alpha_min), is_valid(g)
    support = frame * radius[None, :, None, None]
    if mean.shape[0] == 1:
        longest = radius * _largest(g.scale[0])
    else:
        # Control points between keys have axes of any length and angle.
        longest = jnp.sqrt(jnp.max(jnp.sum(support * support, axis=(-2, -1)), axis=0))
    low, high = jnp.min(mean, axis=0).T, jnp.max(mean, axis=0).T
    way = jnp.sqrt(sum((b - a) ** 2 for a, b in zip(low, high, strict=True))) / 2
    slack = SLACK * sum(jnp.abs(x) for x in (*low, *high))
    size = (longest + way) * (1 + SLACK) + slack
    sphere = _sphere((low + high) / 2, size, fine, radius)
    return _Shapes(jnp.stack(sphere), _states(mean, support)), jnp.sum(~fine, dtype=jnp.int32)


def _transient_shapes(
    motion: Motion, span: Float[Array, "2"], alpha_min: float
) -> tuple[_Shapes, Int[Array, ""]]:
    """Transient Gaussians, and how many of them are not finite."""
    t = motion.transient
    if t is None:
        none = jnp.zeros((SPHERE_ROWS + WINDOW_ROWS, 0), jnp.float32)
        return _Shapes(none, jnp.zeros((0, STATE_ROWS + WINDOW_ROWS), jnp.float32)), jnp.int32(0)
    own = still(t.gaussians)
    mean, frame = control_points(own)
    radius, fine = reach_radius(t.opacity, alpha_min), is_valid(own.gaussians)
    window, beyond = time_window_of(t), jnp.where(radius > 0, radius, 1)
    # A lifetime without end has rate 0: it is alive at all times.
    rate = jnp.where(window.rate > 0, window.rate, 1)
    length = jnp.where(window.rate > 0, (window.plateau + radius / rate) * (1 + SLACK), jnp.inf)
    fade = window.rate / beyond
    times = [*window.velocity.T, window.instant, length, window.plateau, fade]
    # With slack for the rounding of the way from the instant.
    ends = jnp.abs(clipped_time(motion.time_range, span)[:, None] - window.instant[None])
    moved = jnp.minimum(length, jnp.max(ends, axis=0))[:, None] * jnp.abs(window.velocity)
    slack = 4 * SLACK * _total(jnp.abs(mean[0]) + jnp.where(jnp.isfinite(moved), moved, 0))
    size = radius * _largest(t.scale) * (1 + SLACK) + slack
    sphere = jnp.stack([*_sphere(mean[0].T, size, fine, radius), *times])
    states = _states(mean, frame * radius[None, :, None, None])
    row = jnp.concatenate([states, jnp.stack(times, axis=1)], axis=1)
    return _Shapes(sphere, row), jnp.sum(~fine, dtype=jnp.int32)


def _sphere(center: Array, size: Array, fine: Array, radius: Array) -> list[Array]:
    """Rows of spheres; those of Gaussians that no list may hold contain nothing."""
    return [*jnp.where(fine[None], center, 0), jnp.where(fine & (radius > 0), size, -jnp.inf)]


def _largest(x: Float[Array, "gaussians 3"]) -> Float[Array, " gaussians"]:
    return jnp.maximum(jnp.maximum(x[:, 0], x[:, 1]), x[:, 2])


def _total(x: Float[Array, "gaussians 3"]) -> Float[Array, " gaussians"]:
    return x[:, 0] + x[:, 1] + x[:, 2]


def _states(
    mean: Float[Array, "keys gaussians 3"], support: Float[Array, "keys gaussians 3 3"]
) -> Float[Array, "gaussians numbers"]:
    turned = jnp.swapaxes(support, -2, -1).reshape(*mean.shape[:2], 9)
    return jnp.concatenate([x for k in range(len(mean)) for x in (mean[k], turned[k])], axis=1)


def _sides(bundles: Bundles, time_range: Array | None) -> tuple[Array, Array, Array, Array]:
    """Bounds of bundles, as operands."""
    count = bundles.offset.shape[0]
    span = clipped_time(time_range, jnp.stack([bundles.earliest, bundles.latest], axis=1))
    active = bundles.active.astype(jnp.float32)
    return bundles.normal.reshape(count, 15), bundles.offset, active, span


@allocating_code
def _bounds_of(frame, first):
    return Sides(
        floats(operand(frame, first)),
        floats(operand(frame, first + 1)),
        floats(operand(frame, first + 2)),
        floats(operand(frame, first + 3)),
    )


class _Levels(NamedTuple):
    """Bounds of bundles from the finest level to the coarsest."""

    fine: Any
    coarse: Any
    coarsest: Any


class _Kept(NamedTuple):
    """Buffers of a thread for Gaussians of one kind: numbers of those that reach into a coarsest
    bundle, and their spheres; numbers of those of them that reach into a coarse one; and numbers of
    a run of these, side by side."""

    all: Any
    sphere: Any
    some: Any
    near: Any


@allocating_code
def _kept(sphere, row):
    numbers, count = sphere.shape
    return _Kept(
        np.empty(count + 1, np.int32),
        np.empty((numbers, count), np.float32),
        np.empty(count + 1, np.int32),
        np.empty((row.shape[1], TESTED_AT_ONCE), np.float32),
    )


@machine_code
def _list_bundle(shapes, levels, kept, work, bundle, lists):
    """Append the Gaussians of one kind to the lists of all bundles of a coarsest bundle. Those that
    find no place are counted."""
    sphere, row, base = shapes
    count, places = lists
    slots = len(places) // len(count)
    fine, coarse, coarsest = levels
    some = len(coarse.offset) // len(coarsest.offset)
    fan = len(fine.offset) // len(coarse.offset)
    length = spheres_inside(sphere, sphere.shape[1], coarsest, bundle, kept.all, work)
    for c in range(sphere.shape[0]):
        for i in range(length):
            kept.sphere[c, i] = sphere[c, kept.all[i]]
    for parent in range(bundle * some, (bundle + 1) * some):
        number = spheres_inside(kept.sphere, length, coarse, parent, kept.some, work)
        for begin in range(0, number, TESTED_AT_ONCE):
            run = min(TESTED_AT_ONCE, number - begin)
            for i in range(run):
                own = row[kept.all[kept.some[begin + i]]]
                for c in range(len(own)):
                    kept.near[c, i] = own[c]
            for child in range(parent * fan, (parent + 1) * fan):
                ellipsoids_inside(kept.near, run, row.shape[1] // STATE_ROWS, fine, child, work)
                number_of_child = child - bundle * some * fan
                met, at = count[number_of_child], number_of_child * slots
                for i in range(run):
                    if not work.room[i] < 0:
                        if met < slots:
                            places[at + met] = base + kept.all[kept.some[begin + i]]
                        met += 1
                count[number_of_child] = met


@allocating_code
def _list_bundles(shared):
    """Fill the places of the bundles of all coarsest bundles that no other thread takes."""
    frame = call_frame(shared)
    sphere, row = floats(operand(frame, 0)), floats(operand(frame, 1))
    brief, brief_row = floats(operand(frame, 2)), floats(operand(frame, 3))
    levels = _Levels(_bounds_of(frame, 4), _bounds_of(frame, 8), _bounds_of(frame, 12))
    kept, brief_kept = _kept(sphere, row), _kept(brief, brief_row)
    work = Work(
        np.empty(TESTED_AT_ONCE, np.float32),
        np.empty(TESTED_AT_ONCE, np.float32),
        np.empty(TESTED_AT_ONCE, np.float32),
        np.empty(TESTED_AT_ONCE, np.float32),
        np.empty(TESTED_AT_ONCE, np.float32),
        np.empty(TESTED_AT_ONCE, np.float32),
    )
    count = integers(result(frame, 2))
    fan = len(count) // max(len(levels.coarsest.offset), 1)
    places = np.empty(fan * _PLACES, np.int32)
    while True:
        bundle = next_piece(shared)
        if bundle >= len(levels.coarsest.offset):
            return
        own = count[bundle * fan : (bundle + 1) * fan]
        while True:
            own[:] = 0
            _list_bundle((sphere, row, 0), levels, kept, work, bundle, (own, places))
            if brief.shape[1] > 0:
                shapes = brief, brief_row, sphere.shape[1]
                _list_bundle(shapes, levels, brief_kept, work, bundle, (own, places))
            longest = np.max(own)
            if longest <= len(places) // fan:
                break
            places = np.empty(fan * (longest + longest // 2), np.int32)
        _store_lists(shared, bundle * fan, own, places)


@machine_code
def _store_lists(shared, first, own, places):
    """Write lists side by side to where no other thread does, as far as they fit.

    `start` is written; `count`, of which `own` is a part, stays what is wanted.

    Args:
        shared: address of the shared state.
        first: the first bundle.
        own: lengths of the lists of the bundles from the first on.
        places: the lists.
    """
    frame = call_frame(shared)
    index, start = integers(result(frame, 0)), integers(result(frame, 1))
    most, slots, total = np.int64(integers(operand(frame, 16))[1]), len(places) // len(own), 0
    for n in range(len(own)):
        total += min(own[n], most)
    at = take_places(shared, total)
    for n in range(len(own)):
        start[first + n] = at
        for i in range(min(own[n], most, len(index) - at)):
            index[at + i] = places[n * slots + i]
        at += min(own[n], most)


@allocating_code
def _join_lists(frame):
    """The sizes that the lists need, and what of each of them fits."""
    index, start, count = (
        integers(result(frame, 0)),
        integers(result(frame, 1)),
        integers(result(frame, 2)),
    )
    sizes, most = integers(result(frame, 3)), np.int64(integers(operand(frame, 16))[1])
    total, longest, lost, filled = 0, 0, 0, 0
    for bundle in range(len(count)):
        wanted = count[bundle]
        total += wanted
        longest = max(longest, wanted)
        filled += min(wanted, most)
        there = max(min(wanted, most, len(index) - start[bundle]), 0)
        count[bundle] = there
        lost += wanted - there
    index[min(filled, len(index)) :] = -1
    sizes[0], sizes[1], sizes[2] = total, longest, lost


@allocating_code
def _extra_threads(frame):
    """Threads to start beside the caller's."""
    pieces = floats(operand(frame, 13)).shape[0]
    return max(min(np.int64(integers(operand(frame, 16))[0]), pieces), 1) - 1


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
