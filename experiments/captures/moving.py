"""Fit captures of moving scenes with variants of options and score the held-out pictures.

    python -m experiments.captures.moving fit CAPTURE ... [--variants NAME ...] [--out DIR]
                                              [--frames FIRST LAST STEP] [--nearest CAMERAS]

Each fit prints one line: PSNR of whole pictures, of the pixels that move (mean over views; and from
all their pixels together, as `gaussray evaluate`), SSIM; PSNR at held-out times, whole and moving;
PSNR of some training pictures, whole and moving; seconds (with compilation), steps, and Gaussians
that are static, moving and transient.
"""

import argparse
import dataclasses
import json
import time
from pathlib import Path

import numpy as np

from experiments.captures.fits import Variant, fit_arguments, fitted, pairs, replaced, varied
from gaussray.capture.capture import Capture, View
from gaussray.capture.frames import read_encoded
from gaussray.capture.open import open_capture
from gaussray.capture.selection import Selection
from gaussray.capture.temporal_median import differs
from gaussray.color import psnr_from_mse
from gaussray.dataset.images import side_by_side, srgb_levels, write_image
from gaussray.evaluate.masks import MotionMasks, levels_and_mask
from gaussray.evaluate.metrics import psnr, ssim
from gaussray.reconstruct.checks.failed_fit import FailedFit
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.runtime.devices import DevicesOptions, start_devices as start_devices
from gaussray.scene.segmented import scene_size
from gaussray.tracer.options import TraceOptions


# Of so many training pictures one is scored; no divisor of usual numbers of times.
_TRAINING = 11

# What fit=auto chooses for a capture of several times on this machine.
BASE = ReconstructOptions()

VARIANTS: dict[str, Variant] = {
    "auto": lambda o: o,
    "given": lambda o: replaced(o, fit__start="given"),
    "stereo": lambda o: replaced(o, fit__start="stereo"),
    "random": lambda o: replaced(o, fit__start="random"),
    "transient": lambda o: replaced(o, fit__motion="transient"),
    "both": lambda o: replaced(o, fit__motion="both"),
    "control": lambda o: replaced(o, fit__motion="control_points"),
    "deformation": lambda o: replaced(
        o,
        fit__auto=False,
        fit__coarse=600,
        fit__fine=16000,
        fit__tiles=512,
        fit__initial_opacity=0.6,
        density__interval=100,
        density__growth=8.0,
    ),
    "nobodies": lambda o: replaced(o, track__poses=0),
    "dssim": lambda o: replaced(o, loss__l1=0.8, loss__dssim=0.2, fit__tile_side=32, fit__tiles=32),
    "degree2": lambda o: replaced(o, fit__degree=2),
    "seed1": lambda o: replaced(o, fit__seed=1),
}

HEAD = (
    *("capture", "variant", "PSNR", "moving", "moving, pooled", "SSIM", "times", "times, moving"),
    *("training", "training, moving"),
    *("seconds", "steps", "static", "moving ones", "transient"),
)


def moving_pixels(masks: MotionMasks, view: View) -> np.ndarray:
    """The pixels of a view that move: those that differ from the temporal median of their camera,
    or, where it moves, from the picture in `still/`, which shows what stands still alone
    (`soft_scenes`); none where there is no such picture."""
    levels = levels_and_mask(view)[0]
    moving = masks.moving(view, levels)
    if moving is not None:
        return moving
    before, found, name = str(view.image).rpartition("/images/")
    image = Path(f"{before}/still/{name}")
    if not (found and image.exists()):
        return np.zeros(levels.shape[:2], bool)
    return differs(levels, levels_and_mask(dataclasses.replace(view, image=image))[0], 255)


def nearest_cameras(capture: Capture, count: int) -> Capture:
    """The capture as if few cameras had been there: the `count` training cameras whose first
    position is nearest to that of the first held-out camera, and this camera."""
    cameras: dict[str, list[View]] = {}
    for view in capture.views:
        cameras.setdefault(view.camera_name, []).append(view)
    place = {
        name: np.asarray(views[0].camera.trajectory.translation)[0]
        for name, views in cameras.items()
    }
    trained = {view.camera_name for view in capture.views if view.split == "train"}
    held_out = next((name for name in cameras if name not in trained), None)
    if held_out is None:
        raise SystemExit(
            f"{capture.folder}: --nearest needs a camera that is held out (split test)."
        )
    near = sorted(trained, key=lambda name: np.linalg.norm(place[name] - place[held_out]))
    kept = {held_out, *near[:count]}
    views = [view for view in capture.views if view.camera_name in kept]
    return dataclasses.replace(capture, views=views)


def scored(view: View, image: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """Scores of one picture; those of moving pixels only if there are any."""
    truth = read_encoded(view)
    score = {"psnr": psnr(truth, image), "ssim": ssim(truth, image)}
    if mask.any():
        error = (truth.astype(np.float64) - image)[mask] / 255
        score |= {"moving": psnr(truth, image, mask), "squared": float(np.sum(error**2))}
        score["values"] = error.size
    return score


def mean_scores(rows: list[dict[str, float]]) -> dict[str, float]:
    """Means over pictures, and PSNR of the moving pixels of all of them together (`pooled`)."""
    means = {}
    for name in ("psnr", "ssim", "moving"):
        values = [row[name] for row in rows if name in row]
        means[name] = float(np.mean(values)) if values else float("nan")
    count = sum(row.get("values", 0) for row in rows)
    squared = sum(row.get("squared", 0.0) for row in rows)
    return means | {"pooled": psnr_from_mse(squared / count) if count else float("nan")}


def fit(
    folder: Path,
    options: ReconstructOptions,
    chosen: argparse.Namespace,
    devices: int | None,
    pictures: Path | None,
) -> dict[str, float]:
    """Fit a capture and score its held-out pictures, at the training times and at all others."""
    selection = Selection(frames=tuple(chosen.frames), scale=chosen.scale)
    capture = open_capture(folder, selection=selection)
    if chosen.nearest:
        capture = nearest_cameras(capture, chosen.nearest)
    trained = {view.time for view in capture.views if view.split == "train"}
    held_out = [view for view in capture.views if view.split == "test"]
    if not held_out:
        raise SystemExit(
            f"{folder}: no picture is held out (split test), so nothing can be scored."
        )
    made = fitted(capture, options, devices, chosen.quiet)
    render = Renderer(
        made.scene, options=RenderOptions(samples=1), trace=TraceOptions(), devices=devices
    )
    masks, images = MotionMasks(capture.views), {}

    def scores(views: list[View]) -> dict[str, float]:
        images.update({view.image: srgb_levels(render(view.camera).color) for view in views})
        return mean_scores([scored(v, images[v.image], moving_pixels(masks, v)) for v in views])

    known = scores([view for view in held_out if view.time in trained])
    between = scores([view for view in held_out if view.time not in trained])
    learnt = scores([view for view in capture.views if view.split == "train"][::_TRAINING])
    if pictures is not None:
        shown = [held_out[len(held_out) // 6], held_out[len(held_out) * 5 // 6]]
        rows = [side_by_side(read_encoded(view), images[view.image], gain=3) for view in shown]
        width = min(row.shape[1] for row in rows)  # cameras may differ in size
        write_image(pictures, np.concatenate([row[:, :width] for row in rows]))
    row = {"seconds": made.seconds, "steps": made.steps, **known}
    row |= {f"between_{name}": value for name, value in between.items()}
    row |= {f"training_{name}": value for name, value in learnt.items()}
    size = scene_size(made.scene)
    row |= {"transient": size.get("transient", 0), "moving_ones": size["moving"]}
    return row | {"static": size["gaussians"] - row["moving_ones"] - row["transient"]}


def line(folder: Path, name: str, row: dict[str, float]) -> str:
    """A row of the table."""
    figures = [f"{row[key]:.2f}" for key in ("psnr", "moving", "pooled")] + [f"{row['ssim']:.3f}"]
    beside = ("between_psnr", "between_moving", "training_psnr", "training_moving")
    figures += [f"{row[key]:.2f}" for key in beside]
    keys = ("seconds", "steps", "static", "moving_ones", "transient")
    figures += [f"{row[key]:.0f}" for key in keys]
    return f"| {' | '.join([folder.name, name, *figures])} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    command = commands.add_parser("fit")
    fit_arguments(command, VARIANTS, "auto")
    command.add_argument("--out", type=Path, help="folder of rows.jsonl and a picture for each fit")
    command.add_argument(
        "--frames", type=int, nargs=3, default=[], help="first, last, step of times"
    )
    command.add_argument("--nearest", type=int, metavar="CAMERAS", help="`nearest_cameras`")
    chosen = parser.parse_args()
    devices = start_devices(DevicesOptions())
    print("| " + " | ".join(HEAD) + " |\n|" + "---|" * len(HEAD), flush=True)
    for folder, name in pairs(chosen):
        picture = None
        if chosen.out is not None:
            chosen.out.mkdir(parents=True, exist_ok=True)
            part = f"_nearest{chosen.nearest}" if chosen.nearest else ""
            stem = "".join(c if c.isalnum() else "-" for c in f"{folder.name}_{name}{part}")
            picture = chosen.out / f"{stem}.png"
        options = varied(BASE, name, VARIANTS, chosen.set)
        try:
            row = fit(folder, options, chosen, devices, picture)
        except FailedFit as error:
            print(f"| {folder.name} | {name} | {error} |", flush=True)
            continue
        print(line(folder, name, row), flush=True)
        if chosen.out is not None:
            record = {"capture": folder.name, "variant": name, "set": chosen.set}
            record |= {key: getattr(chosen, key) for key in ("scale", "frames", "nearest")} | row
            with (chosen.out / "rows.jsonl").open("a") as file:
                file.write(json.dumps(record | {"at": round(time.time())}) + "\n")


if __name__ == "__main__":
    main()
