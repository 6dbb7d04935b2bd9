"""Candidate lists hold every hit and say what did not fit."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from pictures import seen_through
from scenes import OPTIONS, RAYS, moving, rays, shot, wandering

from gaussray.tracer import traverse
from gaussray.tracer.measure import enlarged_capacity, measure
from gaussray.tracer.trace import find_candidates
from gaussray.tracer.traverse import Capacity, capacity_of_device


# Hits that a rounding of single precision could lift over the cut-off do not count.
ALPHA_MIN = (1 + 1e-4) / 255
COUNT = 400
WHOLE = Capacity((50, 800), 6400, 400)
EACH = OPTIONS.bundle**2

search = eqx.filter_jit(find_candidates)


def scene(size=(0.02, 0.2)):
    return wandering(*moving(COUNT, keys=3, size=size, amount=0.2))


def rolling(lines):
    """Rows read one after the other over all key states."""
    return lines._replace(time=np.linspace(-0.1, 1.1, RAYS))


PICTURES = {
    "narrow": lambda: rolling(rays(jitter=0.0)),
    "depth_of_field": lambda: rolling(rays(jitter=0.2)),
    "huge_lens": lambda: rolling(rays(jitter=3.0, spread=1.0)),
    "inside": lambda: rolling(rays(place=(0, 0, 0), spread=3.0)),
    "every_way": lambda: rolling(rays(place=(0, 0, 0), spread=50.0)),
    "fisheye": lambda: seen_through("polynomial"),
    "fisheye_huge_lens": lambda: seen_through("polynomial", radius=1.0),
    "kannala": lambda: seen_through("kannala"),
}


@pytest.mark.parametrize("picture", PICTURES)
def test_every_hit_is_in_the_list_of_its_bundle(picture):
    motion, lines = scene(), shot(PICTURES[picture]())
    lists, skipped = search(motion, lines, options=OPTIONS, capacity=WHOLE)
    assert int(lists.dropped) == int(skipped) == 0
    listed = np.zeros((RAYS, COUNT), bool)
    index, start, count = (np.asarray(x) for x in (lists.index, lists.start, lists.count))
    for ray in range(RAYS):
        own = ray // EACH
        members = index[start[own] : start[own] + count[own]]
        assert len(set(members)) == len(members)
        listed[ray, members] = True
    hit = np.isfinite(reference.hits(motion, lines, alpha_min=ALPHA_MIN)[0])
    assert np.any(hit)
    assert np.all(listed[hit])


@pytest.mark.parametrize("levels", [0, 1, 2])
@pytest.mark.parametrize("capacity", ["whole", "short"])
def test_blocks_are_of_any_size(monkeypatch, levels, capacity):
    motion, lines = scene(), shot(PICTURES["depth_of_field"]())
    room = (800,) * (levels + 1), 6400, 400
    size = Capacity(*room) if capacity == "whole" else Capacity((33,) * (levels + 1), 150, 9)
    options = dataclasses.replace(OPTIONS, levels=levels)
    found = []
    for at_once in (1 << 18, 7):  # everything, and what divides no list
        monkeypatch.setattr(traverse, "_block_size", lambda at_once=at_once: at_once)
        one = jax.jit(lambda *seen: find_candidates(*seen, options=options, capacity=size))
        found.append(one(motion, lines))
    for a, b in zip(*map(jax.tree.leaves, found), strict=True):
        np.testing.assert_array_equal(a, b)
    assert (int(found[0][0].dropped) > 0) == (capacity == "short")


def test_room_in_the_lists_changes_nothing():
    motion, lines = scene(), shot(PICTURES["narrow"]())
    lists, _ = search(motion, lines, options=OPTIONS, capacity=WHOLE)
    wide = Capacity((5000, 9000), 60_000, 5000)
    roomy, _ = search(motion, lines, options=OPTIONS, capacity=wide)
    total = int(jnp.sum(lists.count))
    np.testing.assert_array_equal(roomy.index[:total], lists.index[:total])
    for a, b in zip(jax.tree.leaves(lists)[1:], jax.tree.leaves(roomy)[1:], strict=True):
        np.testing.assert_array_equal(a, b)


def test_lists_are_short_where_rays_are_neighbours():
    lines = seen_through("pinhole", radius=0.0)
    lists, _ = search(scene(), shot(lines), options=OPTIONS, capacity=WHOLE)
    hits = np.isfinite(reference.hits(scene(), shot(lines))[0]).reshape(-1, EACH, COUNT)
    met = np.sum(np.any(hits, axis=1))
    # Measured: 5.1 times as many candidates as Gaussians that some ray of the bundle meets; 1.8 if
    # they rested. They jump by several times their size, and are bounded over the whole arc.
    assert met <= np.sum(lists.count) < 6 * met


def test_what_does_not_fit_is_counted_and_what_is_needed_suffices():
    small = Capacity((50, 800), 500, 32)
    motion, lines = scene(), shot(rolling(rays()))
    whole, _ = search(motion, lines, options=OPTIONS, capacity=WHOLE)
    lists, _ = search(motion, lines, options=OPTIONS, capacity=small)
    assert int(lists.dropped) > 0
    assert int(jnp.sum(lists.count)) < int(jnp.sum(whole.count))
    needed = [int(n) for n in lists.needed]
    held = [*small.cells, small.pairs, small.slots]
    assert any(n > h for n, h in zip(needed, held, strict=True))
    # What came after the overflow saw only a part: a lower bound, so at most one try per size.
    for _ in range(4):
        small = enlarged_capacity(small, needed)
        lists, _ = search(motion, lines, options=OPTIONS, capacity=small)
        needed = [int(n) for n in lists.needed]
        if int(lists.dropped) == 0:
            break
    np.testing.assert_array_equal(lists.count, whole.count)


def test_measured_capacity_suffices_with_head_room():
    motion, lines = scene(), shot(rolling(rays()))
    start = Capacity((20, 800), 6400, 400)
    capacity = measure(motion, lines, options=OPTIONS, capacity=start)
    whole, _ = search(motion, lines, options=OPTIONS, capacity=WHOLE)
    held = np.array([*capacity.cells, capacity.pairs, capacity.slots])
    needed = np.asarray(whole.needed)
    assert np.all(held >= needed) and np.all(held <= 3 * np.maximum(needed, 16))


def test_enlarge_keeps_what_is_large_enough_and_raises_what_nearly_is_not():
    capacity = Capacity((100, 200), 300, 64)
    assert enlarged_capacity(capacity, [80, 160, 240, 64]) == capacity
    grown = enlarged_capacity(capacity, [101, 160, 241, 65])
    assert grown.cells[0] >= 131 and grown.cells[1:] == (200,)
    assert grown.pairs >= 313 and grown.slots == 128


def test_a_device_has_room_for_a_quarter_more_than_its_share():
    whole = Capacity((1000, 40), 4001, 32, 7)
    assert capacity_of_device(whole, 4) == Capacity((313, 64), 1251, 32, 7)
    assert capacity_of_device(whole, 1) == Capacity((1250, 64), 5002, 32, 7)
