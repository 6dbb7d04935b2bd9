"""Lists that are found without a grid hold every hit, and count what finds no place."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from numba import njit
from pictures import seen_through
from scenes import (
    OPTIONS,
    RAYS,
    beside,
    fleeting,
    gaussians,
    look,
    moving,
    rays,
    resting,
    shot,
    stacked,
    wandering,
)
from scipy.spatial.transform import Rotation

from gaussray.runtime.devices import has_machine_code
from gaussray.tracer.bundle import bounds_of_levels
from gaussray.tracer.cpu import cone as cpu_cone, lists as cpu_lists
from gaussray.tracer.measure import measure
from gaussray.tracer.trace import find_candidates, prepare_for_rays
from gaussray.tracer.traverse import Capacity


pytestmark = pytest.mark.skipif(
    not has_machine_code() or jax.default_backend() != "cpu",
    reason="needs Numba and a CPU",
)

# Hits that a rounding of single precision could lift over the cut-off do not count.
ALPHA_MIN = (1 + 1e-4) / 255
COUNT = 400
ROOM, GRID = Capacity((), 16 * COUNT, COUNT, COUNT), (50, 800)
EACH = OPTIONS.bundle**2
# Rounding of single precision, relative to the distance from a cone's apex; `drop_missed` leaves
# room for three times as much.
CONE_SLACK = 3e-7
SIZES = {"size": (0.02, 0.2)}

search = eqx.filter_jit(find_candidates)


def rolling(lines):
    """Rows read one after the other over all key states."""
    return lines._replace(time=np.linspace(-0.1, 1.1, RAYS))


def long_ones(count=COUNT, **kind):
    """Gaussians of which many reach into all half-spaces of a bundle and pass it by."""
    matter = gaussians(count, size=(0.01, 0.03), **kind)
    return matter._replace(scale=matter.scale * [40, 1, 1])


SCENES = {
    "still": lambda: resting(gaussians(COUNT, **SIZES)),
    "long": lambda: resting(long_ones()),
    "moving": lambda: wandering(*moving(COUNT, keys=3, amount=0.2, **SIZES)),
    "transient": lambda: beside(resting(gaussians(200, **SIZES)), fleeting(200, seed=3, **SIZES)),
}
PICTURES = {
    "narrow": lambda: rolling(rays(jitter=0.0)),
    "depth_of_field": lambda: rolling(rays(jitter=0.2)),
    "huge_lens": lambda: rolling(rays(jitter=3.0, spread=1.0)),
    "every_way": lambda: rolling(rays(place=(0, 0, 0), spread=50.0)),
    "fisheye": lambda: seen_through("polynomial"),
}


def members(lists):
    """The Gaussians of every list."""
    index, start, count = (np.asarray(x) for x in (lists.index, lists.start, lists.count))
    return [index[s : s + c] for s, c in zip(start, count, strict=True)]


@pytest.mark.parametrize("levels", [0, 1])
@pytest.mark.parametrize("picture", PICTURES)
@pytest.mark.parametrize("scene", SCENES)
def test_every_hit_is_in_the_list_of_its_bundle(scene, picture, levels):
    motion, lines = SCENES[scene](), shot(PICTURES[picture]())
    options = replace(OPTIONS, levels=levels)
    ready = prepare_for_rays(motion, lines, options, ROOM)
    assert ready.grid is None
    lists, skipped = search(motion, lines, options=options, capacity=ROOM)
    assert int(lists.dropped) == int(skipped) == 0
    hit = np.isfinite(reference.hits(ready.motion, lines, alpha_min=ALPHA_MIN)[0])
    assert np.any(hit)
    for ray in range(RAYS):
        own = members(lists)[ray // EACH]
        assert len(set(own)) == len(own)
        assert set(np.flatnonzero(hit[ray])) <= set(own)


@pytest.mark.parametrize("scene", SCENES)
def test_lists_are_as_short_as_those_of_a_grid(scene):
    motion, lines = SCENES[scene](), shot(seen_through("pinhole", radius=0.0))
    own, _ = search(motion, lines, options=OPTIONS, capacity=ROOM)
    grids, _ = search(motion, lines, options=OPTIONS, capacity=replace(ROOM, cells=GRID))
    # Those of a coarse bundle's cell that no ray of the bundle can meet are left out.
    assert 0 < int(jnp.sum(own.count)) <= 1.02 * int(jnp.sum(grids.count))
    for one, other in zip(members(own), members(grids), strict=True):
        assert len(set(one) - set(other)) <= 0.02 * len(other) + 1


def test_what_finds_no_place_is_counted_and_what_is_needed_suffices():
    motion, lines = SCENES["still"](), shot(PICTURES["narrow"]())
    whole, _ = search(motion, lines, options=OPTIONS, capacity=ROOM)
    pairs, longest = (int(n) for n in np.asarray(whole.needed)[-2:])
    assert pairs == int(jnp.sum(whole.count)) and longest == int(jnp.max(whole.count))
    for room, lost in (
        (replace(ROOM, pairs=pairs, slots=longest), 0),
        (replace(ROOM, pairs=pairs - 5), 5),
    ):
        lists, _ = search(motion, lines, options=OPTIONS, capacity=room)
        assert int(lists.dropped) == lost
        np.testing.assert_array_equal(lists.needed, whole.needed)
    short, _ = search(motion, lines, options=OPTIONS, capacity=replace(ROOM, slots=longest - 1))
    assert int(short.dropped) == int(jnp.sum(whole.count == longest))
    for one, other in zip(members(short), members(whole), strict=True):
        np.testing.assert_array_equal(one, other[: longest - 1])


def test_gaussians_that_are_not_finite_are_counted_and_in_no_list():
    matter = gaussians(COUNT, **SIZES)
    matter.mean[3], matter.scale[7, 1], matter.opacity[9] = np.nan, np.inf, np.nan
    lists, skipped = search(
        resting(matter), shot(PICTURES["narrow"]()), options=OPTIONS, capacity=ROOM
    )
    assert int(skipped) == 3
    assert not {3, 7, 9} & set(np.concatenate(members(lists)))


def test_rays_that_form_no_bundle_and_scenes_of_nothing_have_empty_lists():
    lines = PICTURES["narrow"]()
    lines.direction[:EACH] = 0
    lists, _ = search(SCENES["still"](), shot(lines), options=OPTIONS, capacity=ROOM)
    assert int(lists.count[0]) == 0 < int(jnp.max(lists.count))
    nothing = resting(gaussians(COUNT, **SIZES)._replace(opacity=np.zeros(COUNT)))
    lists, _ = search(nothing, shot(lines), options=OPTIONS, capacity=ROOM)
    assert int(jnp.sum(lists.count)) == 0


def test_measured_sizes_suffice_and_pixels_are_those_of_a_grid():
    motion, lines = SCENES["transient"](), shot(PICTURES["narrow"]())
    room = measure(motion, lines, options=OPTIONS)
    assert room.cells == ()
    pixels, report = look(motion, lines, options=OPTIONS, capacity=room)
    assert int(report.dropped) == 0
    usual, _ = look(motion, lines, options=OPTIONS, capacity=replace(ROOM, cells=GRID))
    np.testing.assert_allclose(stacked(pixels), stacked(usual), atol=1e-6)


@pytest.mark.parametrize("picture", ["narrow", "depth_of_field", "fisheye"])
def test_a_cone_holds_the_rays_of_its_bundle(picture):
    lines = shot(PICTURES[picture]())
    rays = jax.tree.map(lambda x: x[None], lines)
    fine = bounds_of_levels(rays, jnp.zeros(1, jnp.float32), OPTIONS)[-1]
    cones = np.asarray(cpu_cone.bounding_cones(fine), np.float64)
    edges = cones[:, 3:].reshape(-1, 4, 3)
    there = np.linalg.norm(edges[:, 0], axis=-1) > 0
    assert np.mean(there) > 0.4
    inner = np.cross(edges, np.roll(edges, -1, axis=1))
    inner *= np.sign(np.sum(inner * edges.mean(axis=1)[:, None], axis=-1))[..., None]
    inner /= np.maximum(np.linalg.norm(inner, axis=-1, keepdims=True), 1e-30)
    for ray in range(RAYS):
        if np.any(lines.direction[ray]) and there[ray // EACH]:
            o, d = (np.asarray(x[ray], np.float64) for x in (lines.origin, lines.direction))
            bundle = ray // EACH
            for t in (0.0, 1.0, 100.0):
                seen = o + t * d - cones[bundle, :3]
                assert np.all(inner[bundle] @ seen >= -CONE_SLACK * np.linalg.norm(seen) - 1e-9)


@njit
def drop_missed(rows, count, cone, room):
    """What Python may call."""
    cpu_cone.drop_missed(rows, count, cone, room)


def test_a_cone_drops_what_it_misses_and_nothing_that_it_meets():
    # Samples of the cone in double precision: the more, the less falls between them.
    motion, lines = SCENES["long"](), shot(seen_through("pinhole", radius=0.0))
    rays = jax.tree.map(lambda x: x[None], lines)
    fine = bounds_of_levels(rays, jnp.zeros(1, jnp.float32), OPTIONS)[-1]
    cones = np.asarray(cpu_cone.bounding_cones(fine))
    mean = np.asarray(motion.gaussians.mean[0], np.float64)
    scale, quat = (
        np.asarray(getattr(motion.gaussians, n)[0], np.float64) for n in ("scale", "quat")
    )
    frame = Rotation.from_quat(quat[:, [1, 2, 3, 0]]).as_matrix() * 3 * scale[:, None]
    rows = np.concatenate([mean, np.swapaxes(frame, 1, 2).reshape(-1, 9)], axis=1).T
    rows = np.ascontiguousarray(rows, np.float32)
    dropped = missed = 0
    for cone in cones:
        room = np.ones(len(mean), np.float32)
        drop_missed(rows, len(mean), cone, room)
        a, b = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60))
        edges = cone[3:].reshape(4, 3).astype(np.float64)
        share = np.stack([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b], axis=-1)
        d = share.reshape(-1, 4) @ edges
        v = np.linalg.solve(frame[:, None], np.broadcast_to(d, (len(mean), *d.shape))[..., None])
        o = np.linalg.solve(frame, (cone[:3].astype(np.float64) - mean)[..., None])
        v, o = v[..., 0], o[:, None, :, 0]
        far = np.sum(np.cross(o, v) ** 2, axis=-1) / np.sum(v * v, axis=-1)
        met = np.min(far, axis=1) <= 1
        assert not np.any(met & (room < 0))
        # What comes close to a sample may be met between two of them.
        clear = np.min(far, axis=1) > 1.2
        dropped, missed = dropped + np.sum(clear & (room < 0)), missed + np.sum(clear)
    assert dropped > 0.99 * missed > 1000


def test_places_are_not_what_the_longest_list_may_need():
    # A table of so many places for each bundle would take terabytes.
    motion, lines = SCENES["long"](), shot(PICTURES["narrow"]())
    whole, _ = search(motion, lines, options=OPTIONS, capacity=ROOM)
    most = replace(ROOM, slots=2**31 - 1)
    lists, _ = search(motion, lines, options=OPTIONS, capacity=most)
    for one, other in zip(members(lists), members(whole), strict=True):
        np.testing.assert_array_equal(one, other)


def test_threads_change_nothing(monkeypatch):
    motion, lines, found = SCENES["still"](), shot(PICTURES["depth_of_field"]()), []
    for threads in (1, 2, 5):
        monkeypatch.setattr(cpu_lists, "thread_count", lambda n=threads: n)
        # The number of threads is part of a program: each is of a function of its own.
        own = jax.jit(partial(find_candidates, options=OPTIONS, capacity=ROOM))
        found.append(own(motion, lines)[0])
    for other in found[1:]:
        np.testing.assert_array_equal(other.needed, found[0].needed)
        for a, b in zip(members(found[0]), members(other), strict=True):
            np.testing.assert_array_equal(a, b)


def test_without_machine_code_sizes_without_cells_are_refused():
    motion, lines = SCENES["still"](), shot(PICTURES["narrow"]())
    arrays = replace(OPTIONS, backend="array")
    with pytest.raises(ValueError, match="measure it for these rays and options"):
        find_candidates(motion, lines, options=arrays, capacity=ROOM)
