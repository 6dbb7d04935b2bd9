"""Stage 1: pictures become a scene."""

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from gaussray.camera.corrections import corrections_summary, gains, refined_frames
from gaussray.capture.capture import Capture
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.io.atomic import sweep, whole
from gaussray.reconstruct.data.segments import segments
from gaussray.reconstruct.effort import effort, this_machine
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.loop import run_stage
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.options import ReconstructOptions as ReconstructOptions
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.session import Session, hand_over
from gaussray.reconstruct.simplify.prune import required, sentence, total
from gaussray.reconstruct.start import continued_state, initial_state, with_deformation
from gaussray.runtime.devices import leads, wait
from gaussray.runtime.lock import locks_output
from gaussray.runtime.progress import Progress, say
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.scene.store import load_scene, save_scene, scene_info


@locks_output
def reconstruct(
    capture: Capture,
    out: Path | str,
    *,
    options: ReconstructOptions,
    resume: bool = False,
    devices: int | None = None,
    quiet: bool = False,
    told: Callable[[dict[str, Any]], None] | None = None,
) -> Scene | Clip:
    """Fit a scene to the training views of a capture and leave it in `out`/scene.npz.

    A coarse stage on the first instant; then the bodies are tracked, and a fine stage with
    deformation fits all instants. What is kept and returned is what of the scene the pictures
    require (`required`), which requirement.json and, unless `quiet`, a printed line tell;
    cameras.json holds the cameras as they were refined. `out` also gets metrics.jsonl and, at
    intervals, checkpoint.npz, from which `resume` goes on exactly as if nothing had happened. The
    rays of a step are dealt out to so many `devices` (None is all) of every host; the first host
    alone writes. Whatever metrics.jsonl gets is also `told`, line by line.

    A capture of more than options.fit.segment instants becomes a clip, one segment after another:
    each loads its own pictures, starts from what the one before ended with, and is kept in
    `out`/segments until all are there. Cameras are refined in the first one.
    """
    capture, options, sentence_of_effort = effort(capture, options, this_machine())
    _say(sentence_of_effort, quiet or not leads())
    out, course = Path(out), segments(capture, options.fit.segment)
    log = RunLog(out, resume=resume, interval=options.fit.checkpoint, writes=leads(), listener=told)
    if leads():
        sweep(out, deep=len(course) > 1)
    state, progress = log.resumed() if resume else (None, RunProgress(segments=len(course)))
    _demand_same_segments(progress, len(course))
    files = [out / "segments" / f"{i:04d}.npz" for i in range(1, len(course) + 1)]
    files = files if len(files) > 1 else [out / "scene.npz"]
    finished = files[: progress.segment - 1]
    scenes: list[Any] = [load_scene(path) for path in finished]
    reports = [scene_info(path) for path in finished]
    for i in range(len(finished), len(course)):
        session = Session(capture, log, options, quiet or not leads(), devices, course[i])
        state, progress = _fitted(session, state, progress)
        scene, report = _required(session, state, progress, devices)
        if leads():
            _save(files[i], scene, report)
            if i == 0:
                _write_cameras(out / "cameras.json", session, state)
        _say(_found(session, state) if i == 0 else "", session.quiet)
        line = sentence(report, session.name or "the scene") if "steps" in report else ""
        _say(line, session.quiet)
        scenes.append(scene)
        reports.append(report)
        if i + 1 < len(course):
            state, progress = hand_over(session, state, progress)
            log.save(state, progress)
        # Its pictures make room for those of the next segment.
        del session
    result, report = scenes[0], reports[0]
    if len(course) > 1:
        result, report = Clip(tuple(scenes)), total(reports)
        if leads():
            _save(out / "scene.npz", result, report)
        whole_clip = f"the clip of {len(course)} segments"
        _say(sentence(report, whole_clip) if "after" in report else "", quiet or not leads())
    if leads():
        with whole(out / "requirement.json") as partial:
            partial.write_text(json.dumps(report, indent=2) + "\n")
        log.checkpoint.unlink(missing_ok=True)
        if len(course) > 1:
            _remove(files)
    wait("reconstructed")
    return result


def _demand_same_segments(progress: RunProgress, count: int) -> None:
    """Refuse to resume with other segments than before."""
    if progress.segments != count:
        raise ValueError(
            f"fit.segment must cut the capture into {progress.segments} segments, as in the run "
            f"that is resumed, but it is cut into {count}."
        )


def _fitted(
    session: Session, state: State | None, progress: RunProgress
) -> tuple[State, RunProgress]:
    """All stages that are left of a segment."""
    if state is None:
        state, progress = initial_state(session, progress)
    else:
        session.resume(state, progress)
    if progress.stage == "coarse":
        state, progress = run_stage(session, "coarse", state, progress)
        state = with_deformation(session, state, progress)
    elif progress.stage == "begin":
        state, progress = continued_state(session, state, progress)
        state = with_deformation(session, state, progress)
    return (
        run_stage(session, "fine", state, progress) if len(session.times) > 1 else (state, progress)
    )


def _required(
    session: Session, state: State, progress: RunProgress, devices: int | None
) -> tuple[Scene, dict[str, Any]]:
    """What of a fitted scene its pictures require, and the report."""
    scene, unmet = session.scene(state, progress)
    work: list[Progress] = []

    def told(done: int, total: int, what: str) -> None:
        # The first measurement says how many there are; by then the work has begun.
        if not work:
            work.append(session.progress_bar("need", total, patience=2.0))
        work[0].report(done, what)

    return required(
        scene,
        session.footage,
        *session.training_cameras(state),
        unmet=unmet,
        options=session.options.need,
        trace=session.options.trace,
        seed=session.options.fit.seed,
        keys=session.key_states(state),
        devices=devices,
        told=told,
    )


def _save(path: Path, scene: Scene | Clip, report: dict[str, Any]) -> None:
    """Write what a report is about as precisely as it says, and note the bytes that took."""
    parts = report.get("segments", [report])
    save_scene(path, scene, info=report, precision=[part["precision"] for part in parts])
    report["file"] = path.stat().st_size


def _remove(files: list[Path]) -> None:
    """Take away segments that are kept elsewhere."""
    for path in files:
        path.unlink(missing_ok=True)
    with suppress(OSError):
        files[0].parent.rmdir()


def _write_cameras(path: Path, session: Session, state: State) -> None:
    """Write every camera of the capture as refined, and the exposures that were found."""
    corrections, names = state.parameters.corrections, session.names
    views = session.capture.views
    frames = [(view.camera_name, view.camera) for view in views]
    cameras = refined_frames(corrections, session.cameras, names, frames)
    records = [
        FrameRecord(str(view.image.resolve()), camera, view.camera_name, view.split)
        for view, camera in zip(views, cameras, strict=True)
    ]
    gain = gains(corrections, session.cameras, names)
    write_manifest(path, records, extra={"info": {"gain": gain}} if gain else None)


def _found(session: Session, state: State) -> str:
    """What was found of the cameras, nothing if they are as recorded."""
    corrections = state.parameters.corrections
    if corrections is None:
        return ""
    shutter, unit = session.footage.camera.shutter, session.capture.time_unit
    return corrections_summary(corrections, session.cameras, shutter, unit)


def _say(line: str, quiet: bool) -> None:
    if line and not quiet:
        say(line)
