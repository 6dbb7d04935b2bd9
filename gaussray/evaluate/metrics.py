"""PSNR, SSIM and the mask of moving pixels, in double precision."""

from typing import Any

import numpy as np
from jaxtyping import Array, Bool

from gaussray.color import psnr_from_mse


Mask = Bool[np.ndarray, "h w"] | Bool[Array, "h w"]
_WINDOW = 11  # of the SSIM paper: Gaussian, sigma 1.5, cut at 3.5 sigma


def psnr(truth: np.ndarray | Array, image: np.ndarray | Array, mask: Mask | None = None) -> float:
    """Peak signal-to-noise ratio of two pictures.

    Args:
        truth: sRGB-encoded picture (h, w, 3), uint8 or float in 0..1.
        image: the picture to score, of the same size.
        mask: pixels (h, w) to compare; None compares all.

    Returns:
        -10 log10 of the mean squared difference, in dB; infinity for equal pictures, NaN for an
        empty mask.

    Raises:
        ValueError: If sizes or dtypes do not fit.
    """
    truth, image, mask = _pair(truth, image, mask)
    square = (truth - image) ** 2
    if mask is not None:
        square = square[mask]
    if square.size == 0:
        return float("nan")
    return psnr_from_mse(square.mean())


def ssim(truth: np.ndarray | Array, image: np.ndarray | Array, mask: Mask | None = None) -> float:
    """Structural similarity of two pictures (Wang et al. 2004: Gaussian window, sigma 1.5,
    population covariance), mean over channels and pixels.

    Args:
        truth: sRGB-encoded picture (h, w, 3), uint8 or float in 0..1.
        image: the picture to score, of the same size.
        mask: pixels (h, w) over which the SSIM map is averaged, None for all; the border of 5
            pixels, where the window is cut, never counts.

    Returns:
        A value up to 1, which equal pictures have; NaN for an empty mask.

    Raises:
        ValueError: If sizes or dtypes do not fit, or a side is below 11 pixels.
    """
    truth, image, mask = _pair(truth, image, mask)
    if min(truth.shape[:2]) < _WINDOW:
        raise ValueError(
            f"pictures compared by SSIM must have sides of at least {_WINDOW} pixels, "
            f"got {truth.shape[1]} x {truth.shape[0]}."
        )
    # Imported here: that takes a third of a second, which a report without scores does not need.
    from skimage.metrics import structural_similarity

    result: Any = structural_similarity(
        truth,
        image,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=-1,
        full=True,
    )
    mean, local = result
    if mask is None:
        return float(mean)
    cut = _WINDOW // 2
    values = local[cut:-cut, cut:-cut][mask[cut:-cut, cut:-cut]]
    return float(values.mean()) if values.size else float("nan")


def unit_values(image: np.ndarray | Array) -> np.ndarray:
    """Encoded colours in double precision: 8-bit levels divided by 255, floats as they are.

    Args:
        image: the picture.

    Raises:
        ValueError: the pictures are neither uint8 nor floats.
    """
    image = np.asarray(image)
    if image.dtype == np.uint8:
        return image.astype(np.float64) / 255
    if not np.issubdtype(image.dtype, np.floating):
        raise ValueError(f"encoded pictures must be uint8 or floats, got {image.dtype}.")
    return image.astype(np.float64)


def _pair(truth, image, mask):
    truth, image = unit_values(truth), unit_values(image)
    if truth.shape != image.shape or truth.ndim != 3:
        raise ValueError(
            f"the pictures must both be [h, w, 3] of one size, got {truth.shape} and {image.shape}."
        )
    mask = None if mask is None else np.asarray(mask)
    if mask is not None and mask.shape != truth.shape[:2]:
        raise ValueError(
            f"the mask must have the pictures' size {truth.shape[:2]}, got {mask.shape}."
        )
    return truth, image, mask
