"""Fit photographs of a still scene with gsplat, for comparison: 3DGS as MCMC, its published recipe.

    python -m experiments.captures.gsplat_mcmc OUT... [--steps N] [--gaussians N] [--kind 3dgut]

Captures are those of `static prepare`, and held-out views are scored as `static fit` scores them.
One picture a step; 0.8 L1 + 0.2 D-SSIM; 100,000 random Gaussians of opacity 0.5 in a cube of three
times the cameras' extent; harmonics up to degree 3, a degree more after each 1,000 steps; Adam with
rates 1.6e-4 (times the extent; falls to a hundredth), 5e-3, 1e-3, 5e-2, 2.5e-3 and 1.25e-4 for
centres, scales, rotations, opacities and harmonics; opacities and scales cost 0.01; gsplat's
MCMCStrategy, which relocates and adds every 100 steps from step 500 to five sixths of all. The
world is moved and scaled so that the cameras look at the origin from a median distance of 1, as
gsplat's examples do. SSIM is PyTorch's convolutions here; a fused kernel would save some time.

Needs the `peer` extra and a CUDA device. Seconds are those of all steps, without reading pictures
and compilation of gsplat's kernels.
"""

import argparse
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.peer import RASTERIZERS, PeerView, peer_view, rasterize
from gaussray.camera.camera import Camera
from gaussray.capture.capture import View
from gaussray.capture.frames import read_encoded
from gaussray.capture.open import open_capture
from gaussray.capture.selection import Selection
from gaussray.evaluate.metrics import psnr, ssim
from gaussray.scene.harmonics import C0


RATES = {
    "means": 1.6e-4, "scales": 5e-3, "quats": 1e-3, "opacities": 5e-2, "sh0": 2.5e-3,
    "shN": 2.5e-3 / 20,
}  # fmt: skip
START, EXTENT, OPACITY, SIZE = 100_000, 3.0, 0.5, 0.1
DSSIM, COST, DEGREE, RISE = 0.2, 0.01, 3, 1000
# Sides and standard deviation of the window of SSIM.
WINDOW, SIGMA = 11, 1.5


class Picture(NamedTuple):
    """A picture in sRGB values 0..1, and its camera in the normalised world."""

    color: np.ndarray
    view: PeerView


def pictures(views: list[View], centre: np.ndarray, scale: float) -> list[Picture]:
    """Pictures of some views, with cameras in a world that is moved by -centre, then scaled."""
    found = []
    for view in views:
        seen, color = peer_view(view.camera), read_encoded(view)
        pose = np.linalg.inv(seen.camera_from_world)
        pose[:3, 3] = (pose[:3, 3] - centre) * scale
        color = color / 255 if color.dtype == np.uint8 else color
        found.append(
            Picture(color.astype(np.float32), seen._replace(camera_from_world=np.linalg.inv(pose)))
        )
    return found


def focus(cameras: list[Camera]) -> tuple[np.ndarray, float]:
    """The point nearest to all optical axes, and 1 / the cameras' median distance from it."""
    poses = np.stack([np.linalg.inv(peer_view(x).camera_from_world) for x in cameras])
    axis, place = poses[:, :3, 2], poses[:, :3, 3]
    across = np.eye(3) - axis[:, :, None] * axis[:, None]
    centre = np.linalg.lstsq(across.reshape(-1, 3), (across @ place[..., None]).ravel())[0]
    return centre, 1 / float(np.median(np.linalg.norm(place - centre, axis=1)))


def start(extent: float, seed: int) -> dict[str, Any]:
    """Random Gaussians as PyTorch parameters."""
    import torch

    dice = np.random.default_rng(seed)
    mean = EXTENT * extent * dice.uniform(-1, 1, (START, 3))
    near = cKDTree(mean).query(mean, 4)[0][:, 1:]
    size = np.log(SIZE * np.sqrt((near**2).mean(axis=1)))
    arrays = {
        "means": mean,
        "scales": np.repeat(size[:, None], 3, axis=1),
        "quats": dice.uniform(size=(START, 4)),
        "opacities": np.full(START, np.log(OPACITY / (1 - OPACITY))),
        "sh0": (dice.uniform(size=(START, 1, 3)) - 0.5) / C0,
        "shN": np.zeros((START, (DEGREE + 1) ** 2 - 1, 3)),
    }
    tensors = {k: torch.tensor(x, dtype=torch.float32, device="cuda") for k, x in arrays.items()}
    return torch.nn.ParameterDict({k: torch.nn.Parameter(x) for k, x in tensors.items()})


def drawn(view: PeerView, parameters: Any, degree: int, kind: str) -> tuple[Any, Any]:
    """A rendering, and gsplat's further results."""
    import torch

    values = {
        "means": parameters["means"],
        "quats": parameters["quats"],
        "scales": torch.exp(parameters["scales"]),
        "opacities": torch.sigmoid(parameters["opacities"]),
        "colors": torch.cat([parameters["sh0"], parameters["shN"]], dim=1),
    }
    return rasterize(view, values, kind, sh_degree=degree)


def similarity(a: Any, b: Any) -> Any:
    """Mean SSIM of two pictures [h, w, 3], where the window lies inside."""
    import torch

    steps = torch.arange(WINDOW, device=a.device) - WINDOW // 2
    window = torch.exp(-(steps**2) / (2 * SIGMA**2))
    window = (window / window.sum()).expand(15, 1, WINDOW)
    a, b = a.permute(2, 0, 1), b.permute(2, 0, 1)
    maps = torch.cat([a, b, a * a, b * b, a * b])[None]
    maps = torch.nn.functional.conv2d(maps, window[..., None], groups=15)
    maps = torch.nn.functional.conv2d(maps, window[..., None, :], groups=15)[0]
    mean_a, mean_b, square_a, square_b, product = maps.split(3)
    above = (2 * mean_a * mean_b + 1e-4) * (2 * (product - mean_a * mean_b) + 9e-4)
    below = (mean_a**2 + mean_b**2 + 1e-4) * (square_a - mean_a**2 + square_b - mean_b**2 + 9e-4)
    return (above / below).mean()


def fit(seen: list[Picture], steps: int, gaussians: int, kind: str, seed: int) -> tuple[Any, float]:
    """Parameters after so many steps, and seconds."""
    import torch
    from gsplat.strategy import MCMCStrategy

    torch.manual_seed(seed)
    # Variances are differences of squares, for which TF32 is too coarse.
    torch.backends.cudnn.allow_tf32 = False
    place = np.stack([np.linalg.inv(picture.view.camera_from_world)[:3, 3] for picture in seen])
    extent = 1.1 * float(np.linalg.norm(place - place.mean(axis=0), axis=1).max())
    parameters = start(extent, seed)
    rates = RATES | {"means": RATES["means"] * extent}
    optimizers = {
        k: torch.optim.Adam([{"params": x, "lr": rates[k], "name": k}], eps=1e-15)
        for k, x in parameters.items()
    }
    fall = torch.optim.lr_scheduler.ExponentialLR(optimizers["means"], 0.01 ** (1 / steps))
    strategy = MCMCStrategy(cap_max=gaussians, refine_stop_iter=steps * 5 // 6)
    strategy.check_sanity(parameters, optimizers)
    state = strategy.initialize_state()
    truth = [torch.tensor(picture.color, device="cuda") for picture in seen]
    dice, order = np.random.default_rng(seed), []
    # The first call compiles or loads gsplat's kernels.
    drawn(seen[0].view, parameters, 0, kind)
    torch.cuda.synchronize()
    began = time.perf_counter()
    for step in range(steps):
        order = order or list(dice.permutation(len(seen)))
        i = order.pop()
        image, info = drawn(seen[i].view, parameters, min(step // RISE, DEGREE), kind)
        loss = (1 - DSSIM) * (image - truth[i]).abs().mean()
        loss = loss + DSSIM * (1 - similarity(image, truth[i]))
        loss = loss + COST * torch.sigmoid(parameters["opacities"]).mean()
        loss = loss + COST * torch.exp(parameters["scales"]).mean()
        loss.backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        fall.step()
        strategy.step_post_backward(
            parameters, optimizers, state, step, info, lr=fall.get_last_lr()[0]
        )
    torch.cuda.synchronize()
    return parameters, time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--steps", type=int, default=7000)
    parser.add_argument("--gaussians", type=int, default=1_000_000, help="largest number")
    parser.add_argument("--kind", choices=list(RASTERIZERS), default="3dgut")
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    import torch

    print("| capture | rasterizer | PSNR | SSIM | seconds | steps | Gaussians |\n|" + "---|" * 7)
    for folder in chosen.folders:
        views = open_capture(folder, selection=Selection(scale=chosen.scale)).views
        training = [view for view in views if view.split == "train"]
        where = focus([view.camera for view in training])
        parameters, seconds = fit(
            pictures(training, *where), chosen.steps, chosen.gaussians, chosen.kind, chosen.seed
        )
        scores = []
        held_out = [view for view in views if view.split == "test"]
        for view, picture in zip(held_out, pictures(held_out, *where), strict=True):
            with torch.no_grad():
                image, _ = drawn(picture.view, parameters, DEGREE, chosen.kind)
            levels = np.round(255 * image.clamp(0, 1).cpu().numpy()).astype(np.uint8)
            truth = read_encoded(view)
            scores.append((psnr(truth, levels), ssim(truth, levels)))
        mean = np.mean(scores, axis=0)
        print(
            f"| {folder.name} | {chosen.kind} | {mean[0]:.2f} | {mean[1]:.3f} | {seconds:.0f} | "
            f"{chosen.steps} | {len(parameters['means'])} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
