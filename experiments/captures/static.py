"""Fit folders of photographs of a still scene, score held-out views, compare settings.

    python -m experiments.captures.static prepare SOURCE OUT [--scale S] [--hold N]
    python -m experiments.captures.static fit OUT... [--variants NAME ...] [--steps N]

Each fit prints one line: variant, PSNR and SSIM of the held-out views, PSNR of the worst,
seconds (with compilation), steps and Gaussians.
"""

import argparse
from pathlib import Path

import numpy as np

from experiments.captures.fits import Variant, fit_arguments, fitted, pairs, replaced, varied
from gaussray.capture.frames import read_encoded
from gaussray.capture.open import open_capture
from gaussray.capture.selection import Selection
from gaussray.dataset.images import srgb_levels, write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.evaluate.metrics import psnr, ssim
from gaussray.reconstruct.checks.failed_fit import FailedFit
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.learning_rates import OptimizerOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.options import FitOptions, ReconstructOptions
from gaussray.reconstruct.simplify.prune import PruneOptions
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.runtime.devices import DevicesOptions, start_devices as start_devices
from gaussray.tracer.options import TraceOptions


def prepare(source: Path, out: Path, scale: float, hold: int, background: str) -> None:
    """A copy of a capture of stills at a scale, each `hold`-th picture (in the order of the names)
    held out, and alpha composited over the background."""
    chosen = Selection(scale=scale)
    views = open_capture(source, background=background, selection=chosen).views
    views = sorted(views, key=lambda view: view.image)
    alike = len({view.image.stem for view in views}) < len(views)
    records = []
    for i, view in enumerate(views):
        # Cameras may name their pictures alike, each in a folder of its own.
        name = f"images/{i:05d}.png" if alike else f"images/{view.image.stem}.png"
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        write_image(out / name, srgb_levels(read_encoded(view)))
        split = "train" if i % hold else "test"
        records.append(FrameRecord(name, view.camera, view.camera_name, split))
    write_manifest(out / "transforms.json", records)
    print(f"{out}: {len(records)} pictures")


def base(steps: int, tiles: int, gaussians: int, degree: int) -> ReconstructOptions:
    """Relocation with the published rates, for random points."""
    return ReconstructOptions(
        fit=FitOptions(
            auto=False, coarse=1, fine=steps - 1, tiles=tiles, tile_side=32, degree=degree,
            degree_interval=max(steps // 7, 1), initial_opacity=0.5, initial_scale=0.6,
            points=gaussians // 4, surround=0.15,
        ),
        loss=LossOptions(l1=0.8, dssim=0.2),
        optimizer=OptimizerOptions(),
        density=DensityOptions(
            kind="relocate", interval=100, start=0.04, stop=0.85, opacity=0.005,
            gaussians=gaussians,
        ),
        trace=TraceOptions(levels=0, transmittance_min=1e-3),
        prune=PruneOptions(loss=0.0),
    )  # fmt: skip


def _tiles(side: int) -> Variant:
    """Tiles of another side, as many pixels a step."""
    return lambda o: replaced(
        o, fit__tile_side=side, fit__tiles=o.fit.tiles * (o.fit.tile_side // side) ** 2
    )


VARIANTS: dict[str, Variant] = {
    "auto": lambda o: ReconstructOptions(),
    "base": lambda o: o,
    "split": lambda o: replaced(
        o, density__kind="split", density__opacity=0.02, density__growth=8.0, density__start=0.15,
        density__stop=0.7, fit__points=o.density.gaussians // 8,
    ),
    "l1": lambda o: replaced(o, loss__l1=1.0, loss__dssim=0.0),
    "tiles8": _tiles(8),
    "tiles16": _tiles(16),
    "degree0": lambda o: replaced(o, fit__degree=0),
    "degree2": lambda o: replaced(o, fit__degree=2),
    "budget/2": lambda o: replaced(
        o, density__gaussians=o.density.gaussians // 2, fit__points=o.fit.points // 2
    ),
    "budget*2": lambda o: replaced(
        o, density__gaussians=o.density.gaussians * 2, fit__points=o.fit.points * 2
    ),
    "random": lambda o: replaced(o, fit__start="random"),
    "few": lambda o: replaced(o, fit__points=o.density.gaussians // 8),
    "often": lambda o: replaced(o, density__interval=50),
    "full": lambda o: replaced(o, fit__points=o.density.gaussians),
    "opaque": lambda o: replaced(o, fit__initial_opacity=0.9),
    "faint": lambda o: replaced(o, fit__initial_opacity=0.1),
    "published": lambda o: replaced(
        o, optimizer__mean=0.1, optimizer__quat=1e-3, optimizer__scale=5e-3,
        optimizer__color=2.5e-3, optimizer__harmonics=1.25e-4, optimizer__decay=0.1,
    ),
    "slow": lambda o: replaced(
        o, optimizer__quat=3e-3, optimizer__scale=1e-2,
        optimizer__color=7e-3,
    ),
    "still": lambda o: replaced(o, density__noise=0.0),
    "free": lambda o: replaced(o, density__opacity_cost=0.0, density__scale_cost=0.0),
    "cheap": lambda o: replaced(o, density__opacity_cost=0.002, density__scale_cost=0.002),
    "fine": lambda o: replaced(o, fit__footprint=0.1),
    "rough": lambda o: replaced(o, trace__transmittance_min=1e-2),
    "error": lambda o: replaced(o, fit__error_share=0.5),
    "harmonics": lambda o: replaced(o, optimizer__harmonics=2e-3),
}  # fmt: skip


def fit(
    folder: Path, options: ReconstructOptions, scale: float, devices: int | None, quiet: bool
) -> dict[str, float]:
    """Fit a capture and score its held-out views."""
    # The first time, of a video.
    capture = open_capture(folder, selection=Selection(frames=(0, 0, 1), scale=scale))
    made = fitted(capture, options, devices, quiet)
    sampling = RenderOptions(samples=1)
    render = Renderer(made.scene, options=sampling, trace=TraceOptions(), devices=devices)
    scores = []
    for view in (view for view in capture.views if view.split == "test"):
        truth, image = read_encoded(view), srgb_levels(render(view.camera).color)
        scores.append((psnr(truth, image), ssim(truth, image)))
    report = dict(zip(("psnr", "ssim"), np.mean(scores, axis=0).tolist(), strict=True))
    report["worst"] = min(score[0] for score in scores)
    return report | {"seconds": made.seconds, "step": made.steps, "gaussians": made.gaussians}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    command = commands.add_parser("prepare")
    command.add_argument("source", type=Path)
    command.add_argument("out", type=Path)
    command.add_argument("--scale", type=float, default=1.0)
    command.add_argument("--hold", type=int, default=7)
    command.add_argument("--background", default="auto")
    command = commands.add_parser("fit")
    fit_arguments(command, VARIANTS, "base")
    command.add_argument("--steps", type=int, default=3000)
    command.add_argument("--tiles", type=int, default=32)
    command.add_argument("--gaussians", type=int, default=100_000)
    command.add_argument("--degree", type=int, default=3)
    chosen = parser.parse_args()
    if chosen.command == "prepare":
        prepare(chosen.source, chosen.out, chosen.scale, chosen.hold, chosen.background)
        return
    devices = start_devices(DevicesOptions())
    head = ("capture", "variant", "PSNR", "SSIM", "worst view", "seconds", "steps", "Gaussians")
    print(f"| {' | '.join(head)} |\n|" + "---|" * len(head))
    for folder, name in pairs(chosen):
        options = base(chosen.steps, chosen.tiles, chosen.gaussians, chosen.degree)
        options = varied(options, name, VARIANTS, chosen.set)
        try:
            row = fit(folder, options, chosen.scale, devices, chosen.quiet)
        except FailedFit as error:
            print(f"| {folder.name} | {name} | {error} |", flush=True)
            continue
        print(
            f"| {folder.name} | {name} | {row['psnr']:.2f} | {row['ssim']:.3f} | "
            f"{row['worst']:.1f} | {row['seconds']:.0f} | {row['step']:.0f} | "
            f"{row['gaussians']:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
