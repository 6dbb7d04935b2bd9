"""What moves in the pictures of a viewpoint: pixels that differ from the temporal median."""

import numpy as np
from jaxtyping import Bool, Float


# A pixel moves if a channel of its encoded colour, in 0..1, differs by more than this (the
# threshold of the masks of the paired benchmark).
MOTION_THRESHOLD = 0.1
# Where a picture is compared with a rendering, differences are averaged over a square of so many
# pixels along the side first: edges that are rendered a pixel off, and noise, are no motion.
AVERAGED = 5
# There, a pixel must also differ by more than this many times what the median pixel does: as long
# as Gaussians do not show well what stands still, most pixels differ.
OUTLYING = 6.0


def temporal_median(
    pictures: np.ndarray, visible: Bool[np.ndarray, "frames ..."] | None = None
) -> Float[np.ndarray, "... 3"]:
    """Median over the first axis of encoded pictures, of what is visible; NaN where nothing is.

    Args:
        pictures: (frames, ..., 3), 8-bit levels or floats.
        visible: which pixels count; None for all.
    """
    if visible is None:
        return np.median(pictures, axis=0).astype(np.float32)
    levels = np.where(visible[..., None], pictures.astype(np.float32), np.nan)
    levels, count = np.sort(levels, axis=0), visible.sum(axis=0)[None, ..., None]
    middle = [np.maximum(k, 0) for k in ((count - 1) // 2, count // 2)]
    low, high = (np.take_along_axis(levels, k, axis=0)[0] for k in middle)
    return (low + high) / 2


def differs(picture: np.ndarray, other: np.ndarray, scale: int = 1) -> Bool[np.ndarray, "..."]:
    """Whether any channel of each pixel differs by more than `MOTION_THRESHOLD`.

    Args:
        picture: (..., 3), encoded colours in 0..`scale`.
        other: colours to compare with, of the same scale.
        scale: 1 for floats, 255 for 8-bit levels.
    """
    difference = np.abs(picture.astype(np.float32) - other.astype(np.float32))
    return np.any(difference > MOTION_THRESHOLD * scale, axis=-1)


def stands_out(difference: Float[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Which pixels of a picture differ from a rendering of what stands still because they move: by
    more than `MOTION_THRESHOLD` in a channel, and `OUTLYING` times the median pixel.

    Args:
        difference: of encoded colours in 0..1, averaged over squares of `AVERAGED` pixels.
    """
    apart = np.max(np.abs(difference), axis=-1)
    return apart > max(MOTION_THRESHOLD, OUTLYING * float(np.median(apart)))


def moving_mask(
    frames: Float[np.ndarray, "frames h w 3"],
) -> Bool[np.ndarray, "frames h w"]:
    """Moving pixels in the pictures of one camera that stands still.

    Args:
        frames: sRGB-encoded pictures in 0..1.

    Returns:
        The pixels of which a channel differs by more than `MOTION_THRESHOLD` from the temporal
        median.
    """
    median = temporal_median(frames)
    return np.stack([differs(frame, median) for frame in frames])
