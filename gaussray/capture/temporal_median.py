"""What moves in the pictures of a viewpoint: pixels that differ from the temporal median."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from gaussray.runtime.stored_programs import kept_jit


# A pixel moves if a channel of its encoded colour, in 0..1, differs by more than this (the
# threshold of the masks of the paired benchmark).
MOTION_THRESHOLD = 0.1
# Where a picture is compared with a rendering, differences are averaged over a square of so many
# pixels along the side first: edges that are rendered a pixel off, and noise, are no motion.
AVERAGED = 5
# There, a pixel must also differ by more than this many times what the median pixel does: as long
# as Gaussians do not show well what stands still, most pixels differ.
OUTLYING = 6.0
# Pixels of which medians are found at once: of as many, some tens of pictures fit into caches.
MEDIAN_PIXELS = 1 << 14


def temporal_median(
    pictures: np.ndarray, visible: Bool[np.ndarray, "frames ..."] | None = None
) -> Float[np.ndarray, "... 3"]:
    """Median over the first axis of encoded pictures, of what is visible; NaN where nothing is.

    Args:
        pictures: (frames, ..., 3), 8-bit levels or floats.
        visible: which pixels count; None for all.
    """
    if pictures.dtype == np.uint8:
        return _median_level(pictures, visible)
    if visible is None:
        return np.median(pictures, axis=0).astype(np.float32)
    return visible_median(pictures.astype(np.float32), visible)


def visible_median(
    values: Float[np.ndarray, "frames ... 3"], visible: Bool[np.ndarray, "frames ..."]
) -> Float[np.ndarray, "... 3"]:
    """Median over the first axis of what is visible; NaN where nothing is.

    Args:
        values: of any size.
        visible: which of them count.
    """
    ordered = np.sort(np.where(visible[..., None], values, np.nan), axis=0)
    count = visible.sum(axis=0)[None, ..., None]
    middle = [np.maximum(k, 0) for k in ((count - 1) // 2, count // 2)]
    low, high = (np.take_along_axis(ordered, k, axis=0)[0] for k in middle)
    return (low + high) / 2


def _median_level(
    pictures: UInt8[np.ndarray, "frames ... 3"], visible: Bool[np.ndarray, "frames ..."] | None
) -> Float[np.ndarray, "... 3"]:
    """`temporal_median` of 8-bit levels, piece by piece: all have one size, for one program."""
    if len(pictures) == 1:
        alone = pictures[0].astype(np.float32)
        if visible is not None:
            alone[~visible[0]] = np.nan
        return alone
    count, levels = len(pictures), pictures.reshape(len(pictures), -1, 3)
    seen = None if visible is None else visible.reshape(count, -1)
    result = np.empty(levels.shape[1:], np.float32)
    for first in range(0, len(result), MEDIAN_PIXELS):
        piece = slice(first, first + MEDIAN_PIXELS)
        some = _whole_piece(levels[:, piece])
        counted = None if seen is None else _whole_piece(seen[:, piece])
        median = np.asarray(_median_of(some, counted))
        result[piece] = median[: len(result) - first]
    return result.reshape(pictures.shape[1:])


def _whole_piece(values: np.ndarray) -> Array:
    """Values of each frame, filled up to a piece."""
    lack = MEDIAN_PIXELS - values.shape[1]
    if lack:
        values = np.pad(values, ((0, 0), (0, lack), *((0, 0),) * (values.ndim - 2)))
    return jnp.asarray(values)


@kept_jit
def _median_of(
    levels: UInt8[Array, "frames n 3"], visible: Bool[Array, "frames n"] | None
) -> Float[Array, "n 3"]:
    """The median level of each pixel, of the frames in which it is visible; NaN where in none."""
    several = jnp.full((1, 1), len(levels), jnp.int32)
    if visible is not None:
        several = jnp.sum(visible, axis=0, dtype=jnp.int32)[:, None]
        levels = jnp.where(visible[..., None], levels, jnp.uint8(255))
    low = _ranked(levels, jnp.maximum(several - 1, 0) // 2)
    reached = jnp.sum(levels <= low[None], axis=0, dtype=jnp.int32)
    above = jnp.min(jnp.where(levels > low[None], levels, jnp.uint8(255)), axis=0)
    high = jnp.where(reached > several // 2, low, above)
    median = (low.astype(jnp.float32) + high.astype(jnp.float32)) / 2
    return jnp.where(several > 0, median, jnp.nan)


def _ranked(levels: UInt8[Array, "frames n 3"], rank: Int[Array, "#n 1"]) -> UInt8[Array, "n 3"]:
    """The level that so many others precede, found bit by bit: the largest number of which at most
    `rank` levels are smaller. On a CPU several times as fast as sorting."""
    kind = jnp.uint8 if len(levels) < 256 else jnp.int32

    def with_bit(k: Int[Array, ""], found: UInt8[Array, "n 3"]) -> UInt8[Array, "n 3"]:
        tried = found | (jnp.uint8(128) >> k.astype(jnp.uint8))
        below = jnp.sum(levels < tried[None], axis=0, dtype=kind)
        return jnp.where(below.astype(jnp.int32) <= rank, tried, found)

    return jax.lax.fori_loop(0, 8, with_bit, jnp.zeros(levels.shape[1:], jnp.uint8))


def differs(picture: np.ndarray, other: np.ndarray, scale: int = 1) -> Bool[np.ndarray, "..."]:
    """Whether any channel of each pixel differs by more than `MOTION_THRESHOLD`.

    Args:
        picture: (..., 3), encoded colours in 0..`scale`.
        other: colours to compare with, of the same scale.
        scale: 1 for floats, 255 for 8-bit levels.
    """
    if picture.dtype == np.uint8:
        # Bytes that are compared with bytes; what is below the least wraps around to more than lies
        # between both.
        least, most = _alike(other, scale)
        apart = picture - least > most - least
    else:
        other = np.asarray(other, np.float32)
        apart = np.abs(picture.astype(np.float32) - other) > MOTION_THRESHOLD * scale
    # Several times as fast as `np.any`.
    return apart[..., 0] | apart[..., 1] | apart[..., 2]


def _alike(
    other: np.ndarray, scale: int
) -> tuple[UInt8[np.ndarray, "..."], UInt8[np.ndarray, "..."]]:
    """The least and the largest level that does not differ from each colour; 0 and 255 for NaN."""
    if other.dtype == np.uint8:
        least, most = _alike(np.arange(256, dtype=np.float32), scale)
        return least[other], most[other]
    other = np.asarray(other, np.float32)
    # Of a number and NaN, `fmin` and `fmax` return the number.
    least = np.ceil(np.fmin(np.fmax(other - MOTION_THRESHOLD * scale, 0), 255))
    most = np.floor(np.fmax(np.fmin(other + MOTION_THRESHOLD * scale, 255), 0))
    return least.astype(np.uint8), most.astype(np.uint8)


def stands_out(difference: Float[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Which pixels of a picture differ from a rendering of what stands still because they move: by
    more than `MOTION_THRESHOLD` in a channel, and `OUTLYING` times the median pixel.

    Args:
        difference: of encoded colours in 0..1, averaged over squares of `AVERAGED` pixels.
    """
    apart = np.max(np.abs(difference), axis=-1)
    return apart > max(MOTION_THRESHOLD, OUTLYING * float(np.median(apart)))
