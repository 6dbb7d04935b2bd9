"""Errors as people see them, from packages of the extra `metrics`, where they are installed."""

import importlib
import importlib.util
import warnings
from collections.abc import Callable

import numpy as np


Metric = Callable[[np.ndarray, np.ndarray], float]


def perceptual_metrics() -> dict[str, Metric]:
    """Name -> function of (truth, ours), uint8 sRGB codes [h, w, 3], smaller is better.

    `flip`: mean LDR-FLIP (Andersson et al. 2020, NVIDIA's own code) at 67 pixels per degree.
    `lpips`: Zhang et al. 2018, version 0.1 on AlexNet, whose weights torchvision fetches once;
    where they cannot be had it is left out, with a warning. An absent package is left out.
    """
    found: dict[str, Metric] = {}
    if importlib.util.find_spec("flip_evaluator"):
        found["flip"] = _flip()
    if importlib.util.find_spec("lpips"):
        try:
            found["lpips"] = _lpips()
        except (OSError, ImportError) as error:
            warnings.warn(f"LPIPS is left out: its weights are not here ({error}).", stacklevel=2)
    return found


def _flip() -> Metric:
    package = importlib.import_module("flip_evaluator")

    def flip(truth: np.ndarray, ours: np.ndarray) -> float:
        pair = [np.ascontiguousarray(x, np.float32) / 255 for x in (truth, ours)]
        return float(package.evaluate(*pair, "LDR", applyMagma=False)[1])

    return flip


def _lpips() -> Metric:
    torch, package = importlib.import_module("torch"), importlib.import_module("lpips")
    network = package.LPIPS(net="alex", verbose=False)

    def lpips(truth: np.ndarray, ours: np.ndarray) -> float:
        pair = [np.moveaxis(x, -1, 0)[None].astype(np.float32) / 127.5 - 1 for x in (truth, ours)]
        with torch.no_grad():
            return float(network(*(torch.from_numpy(x) for x in pair)))

    return lpips
