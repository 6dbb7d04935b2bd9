"""Stage 1: multi-view video in, a dynamic scene out."""

import json
from pathlib import Path
from typing import Any

from gaussray.atomic import whole
from gaussray.capture.calibration import Capture
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.devices import leads, wait
from gaussray.fit.journal import Journal
from gaussray.fit.refinement import found, gains, refined_frames
from gaussray.fit.state import State
from gaussray.fitting import Fit, ReconstructOptions as ReconstructOptions
from gaussray.requirement import required, sentence
from gaussray.scene.scene import Scene
from gaussray.scene.store import save_scene


def reconstruct(
    capture: Capture,
    out: Path | str,
    *,
    options: ReconstructOptions,
    resume: bool = False,
    devices: int | None = None,
    quiet: bool = False,
) -> Scene:
    """Fit a scene to the training views of a capture and leave it in `out`/scene.npz.

    A coarse stage on the first instant; then the bodies are tracked, and a fine stage with
    deformation fits all instants. What is kept and returned is what of the scene the pictures
    require (`required`), which requirement.json and, unless `quiet`, a printed line tell;
    cameras.json holds the cameras as they were refined. `out` also gets metrics.jsonl and, at
    intervals, checkpoint.npz, from which `resume` goes on exactly as if nothing had happened. The
    rays of a step are dealt out to so many `devices` (None is all) of every host; the first host
    alone writes.
    """
    out = Path(out)
    journal = Journal(out, resume=resume, interval=options.fit.checkpoint, writes=leads())
    fit = Fit(capture, journal, options, quiet or not leads(), devices)
    state, stage = fit.resumed() if resume else (fit.begin(), "coarse")
    if stage == "coarse":
        state = fit.run("coarse", state)
        state = fit.with_deformation(state)
    if len(fit.times) > 1:
        state = fit.run("fine", state)
    whole_scene, unmet = fit.scene(state)
    scene, report = required(
        whole_scene,
        fit.footage,
        *fit.training_cameras(state),
        unmet=unmet,
        options=options.need,
        trace=options.trace,
        seed=options.fit.seed,
        keys=fit.keys(state),
        devices=devices,
    )
    if leads():
        save_scene(out / "scene.npz", scene, info=report, precision=report["precision"])
        report["file"] = (out / "scene.npz").stat().st_size
        with whole(out / "requirement.json") as partial:
            partial.write_text(json.dumps(report, indent=2) + "\n")
        _write_cameras(out / "cameras.json", capture, fit, state)
        journal.checkpoint.unlink(missing_ok=True)
        if not quiet:
            print(*_said(report, fit, state), sep="\n")
    wait("reconstructed")
    return scene


def _write_cameras(path: Path, capture: Capture, fit: Fit, state: State) -> None:
    """Every camera of the capture, as refined, and the exposures that were found."""
    corrections, names = state.parameters.corrections, fit.names
    frames = [(view.camera_name, view.camera) for view in capture.views]
    cameras = refined_frames(corrections, fit.cameras, names, frames)
    records = [
        FrameRecord(str(view.image.resolve()), camera, view.camera_name, view.split)
        for view, camera in zip(capture.views, cameras, strict=True)
    ]
    gain = gains(corrections, fit.cameras, names)
    write_manifest(path, records, extra={"info": {"gain": gain}} if gain else None)


def _said(report: dict[str, Any], fit: Fit, state: State) -> list[str]:
    """What was found of the cameras, and what the scene needed."""
    corrections, lines = state.parameters.corrections, []
    if corrections is not None:
        shutter, unit = fit.footage.camera.shutter, fit.capture.time_unit
        lines.append(found(corrections, fit.cameras, shutter, unit))
    if "steps" in report:
        lines.append(sentence(report))
    return lines
