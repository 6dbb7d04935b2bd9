"""The whole pipeline on the sample capture, from pictures to scored effects."""

import shutil
import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gaussray.capture.formats.paired import read_capture
from gaussray.evaluate.pipeline import EvaluateOptions, evaluate
from gaussray.evaluate.scores import scores_text
from gaussray.io.atomic import write_json
from gaussray.io.sample_data import sample
from gaussray.reconstruct.pipeline import ReconstructOptions, reconstruct
from gaussray.render.renderer import RenderOptions
from gaussray.runtime.devices import leads
from gaussray.runtime.progress import say
from gaussray.tracer.trace import TraceOptions


def demo(
    capture: Path | str | None,
    out: Path | str,
    *,
    reconstruction: ReconstructOptions,
    render: RenderOptions,
    evaluation: EvaluateOptions,
    devices: int | None = None,
    quiet: bool = False,
    told: Callable[[dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Reconstruct, film through every effect at the held-out cameras, compare with the truth.

    Leaves in `out`: scene.npz, report.json, contact_sheet.png, and per effect pictures and videos,
    truth beside ours. An interrupted demo goes on where it stopped. Hosts share the work as they do
    in `reconstruct` and `evaluate`; figures of the fit are `told` as there.
    """
    began = clock.monotonic()
    folder, out = Path(capture or sample("capture")), Path(out)
    if not folder.is_dir():
        raise FileNotFoundError(
            f"{folder}: the sample capture is not there. It ships with the repository and with the "
            "wheel: install one of them whole, or name a capture of yours: capture.path=DIR."
        )
    truth = read_capture(folder)
    resume = (out / "checkpoint.npz").exists()
    shared: dict[str, Any] = {"devices": devices, "quiet": quiet}
    scene = reconstruct(truth, out, options=reconstruction, resume=resume, listener=told, **shared)
    fitted = clock.monotonic()
    trace = TraceOptions()
    some = EvaluateOptions(split="train", frames=26, images=False)
    truth_train = type(truth)(**{**vars(truth), "effects": {}})
    train = evaluate(
        scene, truth_train, out / "train", options=some, render=render, trace=trace, **shared
    )
    report = evaluate(scene, truth, out, options=evaluation, render=render, trace=trace, **shared)
    report["train"] = train["effects"]["pinhole"]
    report["seconds"] = {
        "reconstruct": round(fitted - began, 1),
        "evaluate": round(clock.monotonic() - fitted, 1),
        "total": round(clock.monotonic() - began, 1),
    }
    if not leads():
        return report
    # The training views leave a row in the report, not a folder.
    shutil.rmtree(out / "train", ignore_errors=True)
    write_json(out / "report.json", report)
    say(scores_text({"effects": {"training views": report["train"], **report["effects"]}}))
    facts = report["scene"]
    say(
        f"{facts['gaussians']} Gaussians, of which {facts['moving']} move, "
        f"{facts['bytes'] / 1e6:.1f} MB; {report['seconds']['total']:.0f} s in all. "
        f"See {out / 'contact_sheet.png'} and the videos in {out}."
    )
    return report
