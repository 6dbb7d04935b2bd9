"""Sensor noise: shot noise of photoelectrons and read noise."""

import hashlib

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray


def picture_key(seed: int, name: str) -> PRNGKeyArray:
    """Random key of a picture's noise.

    It depends on the seed and the name alone, not on other pictures or their order: 64 bits of the
    name's SHA-256 are folded into the key.

    Args:
        seed: `sensor.seed`.
        name: name of the picture.
    """
    key = jax.random.key(seed)
    for word in np.frombuffer(hashlib.sha256(name.encode()).digest()[:8], "<u4"):
        key = jax.random.fold_in(key, word)
    return key


def add_noise(
    key: PRNGKeyArray,
    light: Float[Array, "*n"],
    full_well: Float[Array, ""] | float,
    read_noise: Float[Array, ""] | float,
) -> Float[Array, "*n"]:
    """Add shot noise and read noise: (Poisson(full_well light) + Gaussian(read_noise)) / full_well.

    The variance is (full_well light + read_noise^2) / full_well^2. Light below 0 counts as 0; the
    result may be negative. The gradient is that of the mean.

    Args:
        key: random key.
        light: linear light, 1 is `full_well` electrons.
        full_well: electrons, above 0.
        read_noise: standard deviation of the read noise, in electrons.
    """
    shot, read = jax.random.split(key)
    mean = full_well * jnp.maximum(light, 0)
    count = jax.random.poisson(shot, mean, dtype=jnp.int32).astype(light.dtype)
    count += read_noise * jax.random.normal(read, light.shape, light.dtype)
    return (mean + jax.lax.stop_gradient(count - mean)) / full_well
