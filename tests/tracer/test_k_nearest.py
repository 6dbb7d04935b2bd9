"""The nearest hits come in order, round by round."""

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.tracer.k_nearest import nearest_hits, sort_key


def test_nearest_in_rounds_is_a_sort():
    r = np.random.default_rng(0)
    chunks, chunk, count, k = 5, 4, 7, 3
    t = r.uniform(0.5, 8, (chunks, chunk, count)).astype(np.float32)
    missing = r.uniform(size=t.shape) < 0.3
    slot = np.arange(chunks * chunk).reshape(chunks, chunk, 1)
    order = jnp.asarray(t.view(np.int32))
    end = np.iinfo(np.int32).max
    low, high = jnp.min(order, (0, 1), keepdims=True), jnp.max(order, (0, 1), keepdims=True)
    key = jnp.where(missing, end, sort_key(order, jnp.asarray(slot), low, high, jnp.asarray(31)))
    find_next = jax.jit(lambda after: nearest_hits(key, jnp.int32(chunks), after, k=k))
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
    key = sort_key(order, jnp.arange(99, -1, -1, dtype=jnp.int32), *ends, jnp.asarray(2**14 - 1))
    assert np.all(np.diff(np.asarray(key)) > 0)
    assert 0 <= int(key[0]) and int(key[-1]) < np.iinfo(np.int32).max
