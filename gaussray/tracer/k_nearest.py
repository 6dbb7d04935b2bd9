"""Which hits come next along each ray.

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
    """The k smallest keys beyond `after` on every ray, smallest first; none left = the largest int.

    The first `chunks` chunks of the keys are inserted one by one:
    kb[i] <- min(max(x, kb[i-1]), kb[i]), two integer operations a slot.
    """
    none = jnp.iinfo(after.dtype).max
    lowest = jnp.full((1, *after.shape), jnp.iinfo(after.dtype).min, after.dtype)

    def insert(kept: Array, key: Array) -> tuple[Array, None]:
        shifted = jnp.concatenate([lowest, kept[:-1]])
        return jnp.minimum(jnp.maximum(key[None], shifted), kept), None

    def chunk(i: Array, kept: Array) -> Array:
        some = jax.lax.dynamic_index_in_dim(keys, i, keepdims=False)
        return jax.lax.scan(insert, kept, jnp.where(some > after[None], some, none))[0]

    return jax.lax.fori_loop(0, chunks, chunk, jnp.full((k, *after.shape), none, after.dtype))


def slot_mask(count: Int[Array, "*lists"]) -> Int[Array, "*lists"]:
    """The low bits that tell the slots of so many entries apart.

    From the list itself, not from the room that there is for it: what rays see must not depend on
    which frame or step the room was measured with.
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
    """One integer that sorts by distance and remembers the slot in the low bits of the `mask`.

    `order` holds the float bits of t > 0, which sort as t does, between `low` and `high` on this
    ray. Their difference is stretched over all the bits there are before the low ones are given to
    the slot, so distances are told apart to about (high - low) mask 2^-29 in float32, however
    far away they lie. Closer ones are ordered by slot; shading restores their exact order within a
    round.
    """
    # Two bits stay free: the sign, and one that keeps every key below the largest integer.
    shift = jnp.maximum(jax.lax.clz(jnp.maximum(high - low, 0)) - 2, 0)
    # The bounds may be compiled apart from the distances, and differ by their rounding.
    above = jnp.clip(order, low, high) - low
    return ((above << shift) & ~mask.astype(order.dtype)) | slot.astype(order.dtype)
