"""Writes optical flow as KITTI 16-bit PNG and as Middlebury .flo."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from gaussray.dataset.images import write_pixels
from gaussray.io.atomic import atomic_path
from gaussray.io.safe.openimageio import oiio


# KITTI stores 64 levels per pixel of flow, around 2^15.
_KITTI_STEPS, _KITTI_ZERO = 64, 1 << 15
# The first number of a .flo file, and the value of pixels without flow (both of Middlebury).
_FLO_TAG, _FLO_UNKNOWN = np.float32(202021.25), np.float32(1e10)


def write_kitti_flow(path: Path | str, flow: Float[np.ndarray, "h w 2"]) -> None:
    """Write flow as KITTI does: 16-bit RGB of column flow, row flow and whether it is valid.

    Levels are 64 v + 2^15, so that steps are 1/64 pixel. Pixels whose flow is NaN, or does not fit
    (512 pixels), are not valid.

    Args:
        path: the file.
        flow: column and row flow in pixels.

    Raises:
        OSError: the file cannot be written.
    """
    levels = np.round(_KITTI_STEPS * np.nan_to_num(flow, nan=np.inf) + _KITTI_ZERO)
    valid = ((levels >= 0) & (levels < 1 << 16)).all(axis=-1, keepdims=True)
    stored = np.concatenate([np.where(valid, levels, 0), valid], axis=-1).astype(np.uint16)
    spec = oiio.ImageSpec(stored.shape[1], stored.shape[0], 3, oiio.UINT16)
    write_pixels(Path(path), stored, spec)


def write_flo(path: Path | str, flow: Float[np.ndarray, "h w 2"]) -> None:
    """Write flow as a Middlebury .flo file: tag, width, height, then flow in single precision.

    Args:
        path: the file.
        flow: column and row flow in pixels; NaN becomes 1e10, which readers treat as unknown.

    Raises:
        OSError: the file cannot be written.
    """
    values = np.where(np.isnan(flow).any(axis=-1, keepdims=True), _FLO_UNKNOWN, flow)
    head = _FLO_TAG.tobytes() + np.array(flow.shape[1::-1], "<i4").tobytes()
    with atomic_path(path) as partial:
        partial.write_bytes(head + values.astype("<f4").tobytes())
