"""Sample points of a camera: Sobol points over film, lens and shutter, and an integer hash.

Every sample of a pixel is a point of the unit cube with the coordinates film x, film y, lens x,
lens y and shutter. The points are well spread and repeatable: nothing here has a state.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32


# Film x, film y, lens x, lens y, shutter.
DIMENSIONS = 5
# Joe and Kuo's direction numbers (2008) of these dimensions: the primitive polynomial, whose bits
# are its coefficients, and as many odd numbers as its degree. The first dimension needs none.
_DIRECTIONS = ((1, ()), (3, (1,)), (7, (1, 3)), (11, (1, 3, 1)), (13, (1, 1, 1)))
# A float32 holds multiples of 2^-24 in [0, 1) exactly.
_FLOAT_BITS = 24
# Positive root of x^6 = x + 1: the generalised golden ratio of five dimensions (Roberts 2018).
_R_RATIO = 1.1347241384015194


def sobol_samples(count: int) -> Float[Array, "samples 5"]:
    """The first points of the Sobol sequence, each in the middle of its stratum.

    The points are those of `scipy.stats.qmc.Sobol`, in Gray code order. Every coordinate takes
    every value (i + 1/2)/count exactly once, so the mean of a function that is linear in it (the
    times within an exposure) is exact. For a power of two this is Sobol's point plus half a
    stratum; for other counts, whose first points leave strata of Sobol's empty, a coordinate is
    replaced by its rank. A single sample is the centre of the cube.

    Args:
        count: number of samples, at least 1.

    Returns:
        Points in (0, 1).

    Raises:
        ValueError: If `count` is below 1.
    """
    if count < 1:
        raise ValueError(f"samples must be at least 1, got {count}.")
    doublings = (count - 1).bit_length()
    number = np.arange(count)
    # Neighbours in Gray code differ in one bit.
    gray, point = number ^ (number >> 1), np.zeros((count, DIMENSIONS), np.int64)
    for bit, step in enumerate(_steps(doublings)):
        point ^= ((gray >> bit) & 1)[:, None] * step
    # No two points share a coordinate. For a power of two, its rank is its stratum.
    rank = np.argsort(np.argsort(point, axis=0), axis=0)
    return jnp.asarray((rank + 0.5) / count, jnp.result_type(float))


def _steps(doublings: int) -> Int[np.ndarray, "doublings 5"]:
    """What each bit of a point's number adds to its coordinates, in units of 2^-doublings."""
    steps = np.empty((doublings, DIMENSIONS), np.int64)
    for dimension, (polynomial, odd) in enumerate(_DIRECTIONS):
        degree, numbers = len(odd), list(odd) if odd else [1] * doublings
        for bit in range(len(numbers), doublings):
            new = numbers[bit - degree] ^ (numbers[bit - degree] << degree)
            for k in range(1, degree):
                if polynomial >> (degree - k) & 1:
                    new ^= numbers[bit - k] << k
            numbers.append(new)
        steps[:, dimension] = [
            x << doublings - 1 - bit for bit, x in enumerate(numbers[:doublings])
        ]
    return steps


def shifted_samples(count: int, batch: Int[Array, ""]) -> Float[Array, "samples 5"]:
    """`sobol_samples` shifted by a random vector of the batch, modulo 1.

    The mean over each batch is unbiased, and the errors of different batches are independent: their
    scatter is a standard error (randomised quasi-Monte Carlo, Cranley and Patterson 1976).

    Args:
        count: number of samples.
        batch: index of the batch; the shift depends on it alone.
    """
    seed = pcg_hash(batch.astype(jnp.uint32))
    shift = pcg_hash(jnp.arange(DIMENSIONS, dtype=jnp.uint32) + seed)
    return _shifted(sobol_samples(count), shift)


def random_samples(count: int, key: Array) -> Float[Array, "samples 5"]:
    """`sobol_samples` shifted by a random vector, modulo 1.

    The mean over the samples of each key is unbiased (Cranley and Patterson 1976).

    Args:
        count: number of samples.
        key: a `jax.random` key, which gives the shift.
    """
    return _shifted(sobol_samples(count), jax.random.bits(key, (DIMENSIONS,), jnp.uint32))


def step_samples(count: int, step: Int[Array, ""]) -> Float[Array, "samples 5"]:
    """`sobol_samples` shifted by a vector of the training step, modulo 1.

    Successive steps sample different points. The shifts are multiples of the R sequence's vector
    (Roberts 2018), which fill the cube evenly. A single sample stays the centre.

    Args:
        count: number of samples.
        step: number of the training step.
    """
    point = sobol_samples(count)
    if count == 1:
        return point
    ratio = _R_RATIO ** -np.arange(1.0, DIMENSIONS + 1)
    # Multiples of 2^-32 wrap around by themselves, however many steps there are.
    stride = jnp.asarray((ratio * 2**32).astype(np.uint32))
    return _shifted(point, stride * step.astype(jnp.uint32))


def pcg_hash(value: UInt32[Array, "*n"]) -> UInt32[Array, "*n"]:
    """A hash of an integer: one step of the PCG generator (Jarzynski and Olano 2020)."""
    state = value * jnp.uint32(747796405) + jnp.uint32(2891336453)
    word = ((state >> ((state >> 28) + 4)) ^ state) * jnp.uint32(277803737)
    return (word >> 22) ^ word


def _shifted(point: Float[Array, "samples 5"], shift: UInt32[Array, "5"]) -> Array:
    """Points plus a shift in units of 2^-32, modulo 1."""
    # The upper 24 bits are exact in single precision, so the shift is below 1 in any precision.
    moved = point + ((shift >> (32 - _FLOAT_BITS)).astype(point.dtype) / 2**_FLOAT_BITS)[None, :]
    return jnp.where(moved >= 1, moved - 1, moved)
