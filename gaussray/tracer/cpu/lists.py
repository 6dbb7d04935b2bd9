"""Candidate lists on a CPU, in machine code: every coarsest bundle looks at all Gaussians, and its
own bundles at those that it keeps. Nothing is sorted."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.runtime.machine_code import (
    allocating_code,
    floats,
    integers,
    machine_code,
    operand,
    register,
    result,
)
from gaussray.runtime.threads import (
    call_frame,
    entry_address,
    in_threads,
    next_piece,
    take_places,
    thread_count,
)
from gaussray.tracer.bundle import Bundles
from gaussray.tracer.cpu.cone import bounding_cones, drop_missed
from gaussray.tracer.cpu.reach import (
    STATE_ROWS,
    TESTED_AT_ONCE,
    Sides,
    Work,
    ellipsoids_inside,
    spheres_inside,
)
from gaussray.tracer.cpu.shapes import persistent_shapes, transient_shapes
from gaussray.tracer.motion import Motion, clipped_time
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.traverse import Candidates, Capacity


_LISTS = "gaussray_candidate_lists"
# Places for the list of a bundle, at first.
_PLACES = 256
# The largest number of 32 bits.
_MOST = np.iinfo(np.int32).max
# Of `TESTED_AT_ONCE` Gaussians that reach into the half-spaces of a bundle, so many make it
# worthwhile to look which of them its cone misses.
_MANY = 64


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
    persistent, invalid = persistent_shapes(motion, options.alpha_min)
    transient, unusable = transient_shapes(motion, span, options.alpha_min)
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
    cones = bounding_cones(fine)
    index, start, count, sizes = call(*persistent, *transient, *bounds, cones, numbers)
    pairs, longest, lost = sizes
    return Candidates(index, start, count, jnp.stack([pairs, longest]), lost), invalid + unusable


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
    """Bounds of bundles from the finest level to the coarsest, and cones around the finest."""

    fine: Any
    coarse: Any
    coarsest: Any
    cones: Any


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
def _drop_some(near, run, cone, room):
    """Drop Gaussians that a cone misses, if many are left."""
    many = 0
    for i in range(run):
        many += not room[i] < 0
    if many > _MANY:
        drop_missed(near, run, cone, room)


@machine_code
def _copy_column(values, table, column):
    """Copy a row of numbers to a column of a table."""
    for c in range(len(values)):
        table[c, column] = values[c]


@machine_code
def _append_met(place, met, numbers, names, base, room):
    """Append the Gaussians that a bundle meets to its list, and return how many it has met by now;
    those beyond its places are only counted.

    Args:
        place: the places of the list.
        met: how many Gaussians it has met before.
        numbers: places in `names` of the Gaussians that were tested.
        names: indices of the Gaussians, of this kind.
        base: index of the first Gaussian of this kind.
        room: negative for those that the bundle misses.
    """
    for i in range(len(numbers)):
        if not room[i] < 0:
            if met < len(place):
                place[met] = base + names[numbers[i]]
            met += 1
    return met


@machine_code
def _list_bundle(shapes, levels, kept, work, bundle, lists):
    """Append the Gaussians of one kind to the lists of all bundles of a coarsest bundle; those that
    find no place are only counted."""
    sphere, row, base = shapes
    count, places = lists
    slots, stands = len(places) // len(count), row.shape[1] == STATE_ROWS
    fine, coarse, coarsest, cones = levels
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
                _copy_column(row[kept.all[kept.some[begin + i]]], kept.near, i)
            for child in range(parent * fan, (parent + 1) * fan):
                ellipsoids_inside(kept.near, run, row.shape[1] // STATE_ROWS, fine, child, work)
                if stands and cones[child, 3] != cones[child, 6]:
                    _drop_some(kept.near, run, cones[child], work.room)
                own_list = child - bundle * some * fan
                place = places[own_list * slots : (own_list + 1) * slots]
                numbers = kept.some[begin : begin + run]
                met = count[own_list]
                count[own_list] = _append_met(place, met, numbers, kept.all, base, work.room)


@allocating_code
def _list_bundles(shared):
    """Fill the places of the bundles of all coarsest bundles that no other thread takes."""
    frame = call_frame(shared)
    sphere, row = floats(operand(frame, 0)), floats(operand(frame, 1))
    brief, brief_row = floats(operand(frame, 2)), floats(operand(frame, 3))
    cones = floats(operand(frame, 16))
    levels = _Levels(_bounds_of(frame, 4), _bounds_of(frame, 8), _bounds_of(frame, 12), cones)
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
    most, slots, total = np.int64(integers(operand(frame, 17))[1]), len(places) // len(own), 0
    for n in range(len(own)):
        total += min(own[n], most)
    at = take_places(shared, total)
    for n in range(len(own)):
        start[first + n] = min(at, len(index))
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
    sizes, most = integers(result(frame, 3)), np.int64(integers(operand(frame, 17))[1])
    total, longest, lost, filled = 0, 0, 0, 0
    for bundle in range(len(count)):
        wanted = count[bundle]
        total += wanted
        longest = max(longest, wanted)
        filled += min(wanted, most)
        there = min(wanted, most, len(index) - start[bundle])
        count[bundle] = there
        lost += wanted - there
    index[min(filled, len(index)) :] = -1
    sizes[0], sizes[1], sizes[2] = min(total, _MOST), longest, min(lost, _MOST)


@allocating_code
def _extra_threads(frame):
    """Threads to start beside the caller's."""
    pieces = floats(operand(frame, 13)).shape[0]
    return max(min(np.int64(integers(operand(frame, 17))[0]), pieces), 1) - 1


def _find(argument):
    if in_threads(argument, entry_address(), _list_bundles, _extra_threads):
        _join_lists(argument)
    return 0


def register_lists() -> None:
    """Make the search known to XLA (`register`)."""
    register(_LISTS, _find)
