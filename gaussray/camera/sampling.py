"""Which points of film, lens and shutter a pixel's rays go through: well spread, and repeatable."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Num, UInt32


# Film x, film y, lens x, lens y, shutter.
DIMENSIONS = 5
# Primitive polynomials (inner coefficients as bits) and first direction numbers of Joe and Kuo
# (2008), "new-joe-kuo-6", for dimensions 2 to 5; dimension 1 is van der Corput's.
_SOBOL = ((0, (1,)), (1, (1, 3)), (1, (1, 3, 1)), (2, (1, 1, 1)))
_BITS = 24
# Positive root of x^6 = x + 1: the golden ratio of five dimensions.
_R_RATIO = 1.1347241384015194


def samples(count: int) -> Float[Array, "samples 5"]:
    """`count` points of the Sobol sequence, each in the middle of its stratum; one is the centre.

    For a power of two every coordinate takes every value (i + 1/2)/count exactly once, so that the
    mean of anything linear in it (the instants of an exposure) is exact.
    """
    if count < 1:
        raise ValueError(f"samples must be at least 1, got {count}.")
    index = np.arange(count)
    gray = index ^ (index >> 1)
    point = np.zeros((count, DIMENSIONS), np.int64)
    directions = _direction_numbers()
    for bit in range(_BITS):
        point ^= np.where((gray >> bit & 1)[:, None], directions[bit], 0)
    strata = 2 ** int(np.ceil(np.log2(count)))
    return jnp.asarray(point / 2**_BITS + 0.5 / strata, jnp.result_type(float))


def sample_points(count: int, pixel: Num[Array, "2"]) -> Float[Array, "samples 5"]:
    """`samples` shifted by an amount of the pixel's own, wrapping around.

    Neighbouring pixels then err differently: noise instead of a pattern (Cranley and Patterson
    1976). The same pixel always gets the same points; a single one is no longer the centre.
    """
    column, row = pixel.astype(jnp.int32).astype(jnp.uint32)
    return _shifted(samples(count), scrambled(column + scrambled(row)))


def _shifted(point: Float[Array, "samples 5"], seed: UInt32[Array, ""]) -> Array:
    """Points moved by what a seed decides, wrapping around."""
    shift = scrambled(jnp.arange(DIMENSIONS, dtype=jnp.uint32) + seed)
    # 24 bits are exact in single precision, so the shift is below 1 in any.
    shift = (shift >> 8).astype(point.dtype) / 2**24
    moved = point + shift[None, :]
    return jnp.where(moved >= 1, moved - 1, moved)


def shifted_samples(count: int, batch: Int[Array, ""]) -> Float[Array, "samples 5"]:
    """`samples` shifted by a random amount of the batch's own, wrapping around.

    The mean over each batch is right on average, and batches err independently: how far they lie
    apart is a standard error (randomised quasi-Monte Carlo, Cranley and Patterson 1976).
    """
    return _shifted(samples(count), scrambled(batch.astype(jnp.uint32)))


def step_samples(count: int, step: Int[Array, ""]) -> Float[Array, "samples 5"]:
    """`samples` shifted by an amount of the step's own, wrapping around: what one step of a fit
    leaves out, others see. A single one stays the centre.

    The shifts are multiples of the R sequence's (Roberts 2018), which fill the cube evenly.
    """
    point = samples(count)
    if count == 1:
        return point
    ratio = _R_RATIO ** -np.arange(1.0, DIMENSIONS + 1)
    # Multiples of 2^-32 wrap around by themselves, however many steps there are.
    stride = jnp.asarray((ratio * 2**32).astype(np.uint32))
    shift = (stride * step.astype(jnp.uint32) >> 8).astype(point.dtype) / 2**_BITS
    moved = point + shift[None, :]
    return jnp.where(moved >= 1, moved - 1, moved)


def scrambled(value: UInt32[Array, "*n"]) -> UInt32[Array, "*n"]:
    """A scrambled integer (PCG, after Jarzynski and Olano 2020)."""
    state = value * jnp.uint32(747796405) + jnp.uint32(2891336453)
    word = ((state >> ((state >> 28) + 4)) ^ state) * jnp.uint32(277803737)
    return (word >> 22) ^ word


def _direction_numbers() -> np.ndarray:
    """What each bit of the index contributes to each coordinate, in units of 2^-_BITS."""
    columns = [[1] * _BITS]
    for polynomial, first in _SOBOL:
        degree, m = len(first), list(first)
        for i in range(degree, _BITS):
            value = m[i - degree] ^ (m[i - degree] << degree)
            for j in range(1, degree):
                if polynomial >> (degree - 1 - j) & 1:
                    value ^= m[i - j] << j
            m.append(value)
        columns.append(m)
    return np.array([[m[i] << (_BITS - 1 - i) for m in columns] for i in range(_BITS)])
