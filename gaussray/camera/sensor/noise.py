"""Sensor noise: shot noise of photoelectrons and read noise."""

import hashlib

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray


def picture_key(seed: int, name: str) -> PRNGKeyArray:
    """The key of a picture's noise: that of the seed and the name alone, whatever else is taken
    and in which order (64 bits of the name's SHA-256, folded into the key)."""
    key = jax.random.key(seed)
    for word in np.frombuffer(hashlib.sha256(name.encode()).digest()[:8], "<u4"):
        key = jax.random.fold_in(key, word)
    return key


def noisy(
    key: PRNGKeyArray,
    light: Float[Array, "*n"],
    full_well: Float[Array, ""] | float,
    read_noise: Float[Array, ""] | float,
) -> Float[Array, "*n"]:
    """(Poisson(full_well light) + Gaussian(read_noise)) / full_well: light as photosites count it,
    each on its own.

    `full_well` electrons stand for light 1, `read_noise` is the standard deviation in electrons.
    The variance is (full_well light + read_noise^2) / full_well^2. Light below 0 is none, reading
    may be below it. The gradient is that of the mean: none of the chance.
    """
    shot, read = jax.random.split(key)
    mean = full_well * jnp.maximum(light, 0)
    count = jax.random.poisson(shot, mean, dtype=jnp.int32).astype(light.dtype)
    count += read_noise * jax.random.normal(read, light.shape, light.dtype)
    return (mean + jax.lax.stop_gradient(count - mean)) / full_well
