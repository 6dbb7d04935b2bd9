"""The demo: the sample capture is reconstructed, rendered through every effect, and evaluated."""

import dataclasses
import shutil
import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from gaussray.capture.capture import Capture
from gaussray.capture.formats.paired import read_capture
from gaussray.evaluate.options import EvaluateOptions
from gaussray.evaluate.pipeline import evaluate
from gaussray.evaluate.scores import scores_text
from gaussray.io.atomic import write_json
from gaussray.io.sample_data import sample
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.reconstruct.run_state import has_checkpoint
from gaussray.render.options import RenderOptions
from gaussray.runtime.devices import is_primary
from gaussray.runtime.progress import say
from gaussray.tracer.options import TraceOptions


# Pictures that the scene was fitted to, beside which those of held-out cameras are scored.
_TRAINING_VIEWS = EvaluateOptions(split="train", frames=26, images=False)


class DemoOptions(NamedTuple):
    """Options of the two stages and of the evaluation."""

    reconstruct: ReconstructOptions
    render: RenderOptions
    evaluate: EvaluateOptions


def demo(
    capture: Path | str | None,
    out: Path | str,
    *,
    options: DemoOptions,
    devices: int | None = None,
    quiet: bool = False,
    listener: Callable[[dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Reconstruct a capture, render every effect at the held-out cameras, and compare.

    The output folder gets scene.npz, report.json, contact_sheet.png, and per effect pictures and
    videos with the ground truth beside the render. An interrupted demo continues where it stopped.

    Args:
        capture: folder of a paired capture; None is the sample.
        out: the output folder.
        options: options of reconstruction, rendering and evaluation.
        devices: how many devices of this host to use; None is all.
        quiet: whether to report no progress.
        listener: is called with every line of metrics.jsonl.

    Returns:
        The content of report.json: the scores of all effects and of the training views.

    Raises:
        FileNotFoundError: The folder of the capture does not exist.
    """
    began, out = clock.monotonic(), Path(out)
    truth = read_capture(_existing(Path(capture or sample("capture"))))
    scene = reconstruct(
        truth,
        out,
        options=options.reconstruct,
        resume=has_checkpoint(out),
        devices=devices,
        quiet=quiet,
        listener=listener,
    )
    reconstructed = clock.monotonic()

    def scores(of: Capture, folder: Path, chosen: EvaluateOptions) -> dict[str, Any]:
        return evaluate(
            scene,
            of,
            folder,
            options=chosen,
            render=options.render,
            trace=TraceOptions(),
            devices=devices,
            quiet=quiet,
        )

    pinhole = dataclasses.replace(truth, effects={})
    train = scores(pinhole, out / "train", _TRAINING_VIEWS)
    report = scores(truth, out, options.evaluate) | {"train": train["effects"]["pinhole"]}
    report["seconds"] = _seconds(began, reconstructed, clock.monotonic())
    if is_primary():
        # The scores of the training views are a row of the report, not a folder.
        shutil.rmtree(out / "train", ignore_errors=True)
        write_json(out / "report.json", report)
        _tell(report, out)
    return report


def _existing(folder: Path) -> Path:
    """The folder of the capture."""
    if not folder.is_dir():
        raise FileNotFoundError(
            f"{folder}: the sample capture is missing. It is part of the repository and of the "
            "wheel: install one of them completely, or name a capture of yours: capture.path=DIR."
        )
    return folder


def _seconds(began: float, reconstructed: float, ended: float) -> dict[str, float]:
    """How long the stages took."""
    return {
        "reconstruct": round(reconstructed - began, 1),
        "evaluate": round(ended - reconstructed, 1),
        "total": round(ended - began, 1),
    }


def _tell(report: dict[str, Any], out: Path) -> None:
    """Print the scores, and where the pictures are."""
    say(scores_text({"effects": {"training views": report["train"], **report["effects"]}}))
    facts = report["scene"]
    say(
        f"{facts['gaussians']} Gaussians, of which {facts['moving']} move, "
        f"{facts['bytes'] / 1e6:.1f} MB in memory; {report['seconds']['total']:.0f} s in total. "
        f"See {out / 'report.html'}, {out / 'contact_sheet.png'} and the videos in {out}."
    )
