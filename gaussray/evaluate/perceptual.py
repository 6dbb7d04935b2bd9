"""Perceptual metrics (FLIP, LPIPS) from the optional packages of the extra `metrics`."""

import copy
import importlib
import importlib.util
import warnings
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool


# Of truth and image, and of the pixels that count.
Metric = Callable[[np.ndarray, np.ndarray, Bool[np.ndarray, "h w"] | None], float]


def perceptual_metrics() -> dict[str, Metric]:
    """The installed metrics: name -> function of (truth, image, shown).

    `truth` and `image` are uint8 sRGB [h, w, 3]. The result is the mean of the metric's map over
    the pixels `shown` (None: over the whole picture). Smaller is better. An error spreads in the
    map, so that what is hidden must be alike in both pictures.

    `flip`: mean LDR-FLIP (Andersson et al. 2020, NVIDIA's own code) at 67 pixels per degree.
    `lpips`: Zhang et al. 2018, version 0.1 on AlexNet, whose weights torchvision fetches once;
    LPIPS is left out with a warning if these cannot be loaded. Missing packages are left out.
    """
    metrics: dict[str, Metric] = {}
    if importlib.util.find_spec("flip_evaluator"):
        metrics["flip"] = _flip()
    if importlib.util.find_spec("lpips"):
        try:
            metrics["lpips"] = _lpips()
        except (OSError, ImportError) as error:
            warnings.warn(
                f"LPIPS is left out: its weights cannot be loaded ({error}).", stacklevel=2
            )
    return metrics


def _flip() -> Metric:
    package = importlib.import_module("flip_evaluator")

    def flip(truth: np.ndarray, image: np.ndarray, shown: Bool[np.ndarray, "h w"] | None) -> float:
        pair = [np.ascontiguousarray(x, np.float32) / 255 for x in (truth, image)]
        errors, mean, _ = package.evaluate(*pair, "LDR", applyMagma=False)
        return float(mean if shown is None else errors[shown].mean())

    return flip


def _lpips() -> Metric:
    torch, package = importlib.import_module("torch"), importlib.import_module("lpips")
    network = package.LPIPS(net="alex", verbose=False)
    # The same network, with a map as its result.
    mapping = copy.copy(network)
    mapping.spatial = True

    def lpips(truth: np.ndarray, image: np.ndarray, shown: Bool[np.ndarray, "h w"] | None) -> float:
        pair = [np.moveaxis(x, -1, 0)[None].astype(np.float32) / 127.5 - 1 for x in (truth, image)]
        tensors = [torch.from_numpy(x) for x in pair]
        with torch.no_grad():
            if shown is None:
                return float(network(*tensors))
            return float(mapping(*tensors)[0, 0].numpy()[shown].mean())

    return lpips
