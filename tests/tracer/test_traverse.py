"""Candidate lists hold every hit, say what did not fit, and yield the nearest in order."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from pictures import seen_through
from scenes import OPTIONS, RAYS, moving, rays, shot, wandering

from gaussray.tracer import traverse
from gaussray.tracer.trace import enlarge, find, measure
from gaussray.tracer.traverse import Capacity, nearest, pack


pytestmark = pytest.mark.usefixtures("quick_compilation")

# Hits that a rounding of single precision could lift over the cut-off do not count.
ALPHA_MIN = (1 + 1e-4) / 255
COUNT = 400
WHOLE = Capacity((50, 800), 6400, 400)
EACH = OPTIONS.bundle**2

search = eqx.filter_jit(find)


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


def test_lists_that_are_tested_block_by_block_are_the_lists(monkeypatch):
    motion, lines = scene(), shot(PICTURES["depth_of_field"]())
    whole, _ = search(motion, lines, options=OPTIONS, capacity=WHOLE)
    monkeypatch.setattr(traverse, "_AT_ONCE", 7)  # divides no list
    blocks, _ = jax.jit(lambda *seen: find(*seen, options=OPTIONS, capacity=WHOLE))(motion, lines)
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(blocks), strict=True):
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
        small = enlarge(small, needed)
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
    assert enlarge(capacity, [80, 160, 240, 64]) == capacity
    grown = enlarge(capacity, [101, 160, 241, 65])
    assert grown.cells[0] >= 131 and grown.cells[1:] == (200,)
    assert grown.pairs >= 313 and grown.slots == 128


def test_nearest_in_rounds_is_a_sort():
    r = np.random.default_rng(0)
    chunks, chunk, count, k = 5, 4, 7, 3
    t = r.uniform(0.5, 8, (chunks, chunk, count)).astype(np.float32)
    missing = r.uniform(size=t.shape) < 0.3
    slot = np.arange(chunks * chunk).reshape(chunks, chunk, 1)
    order = jnp.asarray(t.view(np.int32))
    end = np.iinfo(np.int32).max
    low, high = jnp.min(order, (0, 1), keepdims=True), jnp.max(order, (0, 1), keepdims=True)
    key = jnp.where(missing, end, pack(order, jnp.asarray(slot), low, high, jnp.asarray(31)))
    find_next = jax.jit(lambda after: nearest(key, jnp.int32(chunks), after, k=k))
    after, found = jnp.full(count, -1, jnp.int32), []
    for _ in range(-(-chunks * chunk // k) + 1):
        found.append(np.asarray(find_next(after)))
        after = jnp.asarray(found[-1][-1])
    found = np.concatenate(found)
    for ray in range(count):
        expected = np.argsort(np.where(missing, np.inf, t)[..., ray].ravel(), kind="stable")
        expected = expected[: np.sum(~missing[..., ray])]
        real = found[:, ray] != end
        np.testing.assert_array_equal(found[real, ray] & 31, expected)


def test_keys_tell_close_distances_apart_however_far_they_lie():
    # A key of 14 slot bits without regard to the range could tell 1000 from 1002, not from 1000.01.
    t = np.linspace(1000, 1001, 100, dtype=np.float32)
    order = jnp.asarray(t.view(np.int32))
    ends = order[:1], order[-1:]
    key = pack(order, jnp.arange(99, -1, -1, dtype=jnp.int32), *ends, jnp.asarray(2**14 - 1))
    assert np.all(np.diff(np.asarray(key)) > 0)
    assert 0 <= int(key[0]) and int(key[-1]) < np.iinfo(np.int32).max
