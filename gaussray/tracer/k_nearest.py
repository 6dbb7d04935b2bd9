"""Selection of the k nearest hits along each ray.

Integers only: nothing here is differentiated.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int


def nearest_hits(
    keys: Int[Array, "chunks chunk *rays"],
    chunks: Int[Array, ""],
    after: Int[Array, "*rays"],
    *,
    k: int,
) -> Int[Array, " k *rays"]:
    """The k smallest keys beyond `after` on every ray.

    Keys are inserted one by one: kb[i] <- min(max(x, kb[i-1]), kb[i]), two integer operations a
    slot.

    Args:
        keys: sort keys of all list entries.
        chunks: number of chunks that are filled.
        after: key behind which hits count.
        k: number of hits.

    Returns:
        The keys, smallest first; the largest integer where none is left.
    """
    none = jnp.iinfo(after.dtype).max
    lowest = jnp.full((1, *after.shape), jnp.iinfo(after.dtype).min, after.dtype)

    def insert(kept: Array, key: Array) -> tuple[Array, None]:
        shifted = jnp.concatenate([lowest, kept[:-1]])
        return jnp.minimum(jnp.maximum(key[None], shifted), kept), None

    def chunk(i: Array, kept: Array) -> Array:
        candidates = jax.lax.dynamic_index_in_dim(keys, i, keepdims=False)
        return jax.lax.scan(insert, kept, jnp.where(candidates > after[None], candidates, none))[0]

    return jax.lax.fori_loop(0, chunks, chunk, jnp.full((k, *after.shape), none, after.dtype))


def slot_mask(count: Int[Array, "*lists"]) -> Int[Array, "*lists"]:
    """Bit mask that holds every slot of a list of `count` entries.

    It depends on the list itself, not on the allocated length: results must not depend on the frame
    or step for which the length was measured.
    """
    most = jnp.maximum(count - 1, 1)
    # The position of the highest bit, twice that, and all bits below.
    return (2 << (jnp.iinfo(most.dtype).bits - 1 - jax.lax.clz(most))) - 1


def sort_key(
    order: Int[Array, "*hits"],
    slot: Int[Array, "*slots"],
    low: Int[Array, "*rays"],
    high: Int[Array, "*rays"],
    mask: Int[Array, "*lists"],
) -> Int[Array, "*hits"]:
    """An integer that sorts by distance and holds the slot in its low bits.

    The difference of `order` and `low` is scaled to all available bits, before its low bits are
    replaced by the slot. So the resolution of distances is about (high - low) mask 2^-29 in
    float32, however far away they are. Closer hits are ordered by slot; shading restores their
    exact order within a round.

    Args:
        order: float bits of the distances t > 0, which sort as t does.
        slot: slot of each hit in its list.
        low: smallest `order` on the ray.
        high: largest `order` on the ray.
        mask: `slot_mask` of the list.
    """
    # Two bits stay free: the sign, and one that keeps every key below the largest integer.
    shift = jnp.maximum(jax.lax.clz(jnp.maximum(high - low, 0)) - 2, 0)
    # The bounds may be compiled apart from the distances, and differ by their rounding.
    above = jnp.clip(order, low, high) - low
    return ((above << shift) & ~mask.astype(order.dtype)) | slot.astype(order.dtype)
