"""Stage 1: pictures become a scene."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from gaussray.capture.capture import Capture
from gaussray.dataset.manifest import CAMERAS_FILE
from gaussray.io.atomic import write_json
from gaussray.io.validate import check_kind
from gaussray.reconstruct.checks.failed_fit import demand_success
from gaussray.reconstruct.data.training_split import demand_training_pictures
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.reconstruct.plan import FitPlan, fit_plan
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.run_state import REQUIREMENT_FILE
from gaussray.reconstruct.same_capture import demand_same_capture, write_capture_facts
from gaussray.reconstruct.segment_fit import (
    fitted_state,
    pruned_segment,
    segment_sentences,
    write_refined_cameras,
)
from gaussray.reconstruct.segment_handover import hand_over
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.shared_results import SharedResults
from gaussray.reconstruct.simplify.summary import clip_report, summary_line
from gaussray.runtime.devices import barrier, is_primary
from gaussray.runtime.lock import locks_output
from gaussray.runtime.progress import tell
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.scene.store import load_scene, save_scene, scene_info


@locks_output
def reconstruct(
    capture: Capture,
    out: Path | str,
    *,
    options: ReconstructOptions | None = None,
    resume: bool = False,
    devices: int | None = None,
    quiet: bool = False,
    listener: Callable[[dict[str, Any]], None] | None = None,
) -> Scene | Clip:
    """Fit a scene to the training views of a capture and save it as `out`/scene.npz.

    The coarse stage fits Gaussians to the pictures of the first time. Then rigid bodies are
    tracked, and the fine stage fits Gaussians and deformation to the pictures of all times. At the
    end the scene is pruned (`pruned_scene`). Where transient Gaussians show what moves
    (options.fit.motion), there is no coarse stage; where cameras move, these and control points
    have one of all times, which fits what stands still; for control points that begin at rest it
    sees a short while. Where options.fit.auto leaves open what shows motion, short fits without
    some pictures decide (`with_motion_tried`).

    A capture of more than options.fit.segment times becomes a clip, one segment after another. Each
    segment loads its own pictures, starts from the end of the one before, and is kept in
    `out`/segments until all are there. Cameras are refined in the first segment.

    Besides scene.npz, `out` gets metrics.jsonl (one line per block of steps), requirement.json (the
    report of pruning), cameras.json (the cameras as refined, for pictures as large as the
    capture's), and, while the run lasts, checkpoint.npz; and motion.json and refine.json, the
    scores of trials, if there were any.

    Pictures of cameras that stand still and that nothing synchronises are looked at together at
    common times; their rays keep the times at which they were recorded (`with_common_times`).

    Corrections of cameras (options.fit.refine) are kept only if held-out tiles gain by them in a
    short fit (options.fit.refine_gain).

    Args:
        capture: pictures and cameras; those of split "train" are used.
        out: the output folder.
        options: all options, one class per config group; None: all defaults, which device and
            capture decide (`FitOptions.auto`).
        resume: go on with the interrupted run in `out`. The result is the same as without the
            interruption.
        devices: how many devices of every host share the rays of a step (None: all). With several
            hosts, only the first writes.
        quiet: print no progress.
        listener: called with every line of metrics.jsonl.

    Returns:
        The scene as saved; a clip if there are several segments.

    Raises:
        ValueError: `out` holds an unfinished run and `resume` is False; or the run to resume had
            other pictures or segments, or refined other parameters of the cameras.
        FileNotFoundError: there is no run to resume.
        NonFiniteLoss: the loss or a parameter became infinite or not a number.
        FailedFit: the fit ended below what one colour per camera scores, or with an empty scene.
        CaptureError: there are no training pictures, or they cannot be used together.
    """
    check_kind("capture", capture, Capture, "what gaussray.open_capture returns")
    rule = "gaussray.ReconstructOptions(fit=gaussray.FitOptions(...), ...)"
    check_kind("options", options, (ReconstructOptions, type(None)), rule)
    demand_training_pictures(capture)
    out, quiet = Path(out), quiet or not is_primary()
    options = ReconstructOptions() if options is None else options
    interval = options.fit.checkpoint
    if resume:
        demand_same_capture(out, capture)
    log = RunLog(out, resume=resume, interval=interval, writes=is_primary(), listener=listener)
    if is_primary():
        write_capture_facts(out, capture)
    plan = fit_plan(
        capture, options, out, fitted_state, resume=resume, devices=devices, quiet=quiet
    )
    state, progress = log.resumed() if resume else (None, RunProgress(segments=len(plan.segments)))
    _demand_same_segments(progress, len(plan.segments))
    files = _scene_files(out, len(plan.segments))
    scenes, reports = _fit_segments(plan, log, state, progress, files, devices=devices, quiet=quiet)
    result, report = scenes[0], reports[0]
    if len(scenes) > 1:
        result, report = Clip(tuple(scenes)), clip_report(reports)
    if is_primary():
        _finish(out, result, report, files, quiet)
        log.checkpoint.unlink(missing_ok=True)
    barrier("reconstructed")
    return result


def _fit_segments(
    plan: FitPlan,
    log: RunLog,
    state: State | None,
    progress: RunProgress,
    files: list[Path],
    *,
    devices: int | None,
    quiet: bool,
) -> tuple[list[Any], list[dict[str, Any]]]:
    """The scenes of all segments and their reports. Those of earlier segments are read from
    `files`; the others are fitted one after another, each from the end of the one before."""
    finished = files[: progress.segment - 1]
    scenes: list[Any] = [load_scene(path) for path in finished]
    reports = [scene_info(path) for path in finished]
    # What trials found out is kept for the first segment alone.
    shared, plan = plan.shared, plan._replace(shared=SharedResults())
    for times, file in zip(plan.segments[len(finished) :], files[len(finished) :], strict=True):
        session = Session(plan.capture, log, plan.options, quiet, devices, times, shared=shared)
        tell(session.equalization.sentence if session.equalization else "", quiet)
        state, progress = fitted_state(session, state, progress)
        # What follows may fail or be killed as well.
        log.save(state, progress)
        scene, report = pruned_segment(session, state, progress, devices)
        report |= {"trial": plan.scores} if plan.scores else {}
        demand_success(scene, report, plan.capture, plan.options.fit.start)
        if is_primary():
            _save(file, scene, report)
            if file == files[0]:
                path, scale = log.out / CAMERAS_FILE, plan.scale
                write_refined_cameras(path, session, state, unscaled=plan.unscaled, scale=scale)
        # Hosts that write no file do not know its size.
        if not quiet:
            for sentence in segment_sentences(session, state, report, first=file == files[0]):
                tell(sentence, quiet)
        scenes.append(scene)
        reports.append(report)
        if file != files[-1]:
            state, progress = hand_over(session, state, progress)
            log.save(state, progress)
        # Its pictures make room for those of the next segment.
        del session
        shared = SharedResults()
    return scenes, reports


def _scene_files(out: Path, count: int) -> list[Path]:
    """The files of the scenes of all segments; of a single one that of the run."""
    if count == 1:
        return [out / "scene.npz"]
    return [out / "segments" / f"{i:04d}.npz" for i in range(1, count + 1)]


def _finish(
    out: Path, result: Scene | Clip, report: dict[str, Any], files: list[Path], quiet: bool
) -> None:
    """Write the scene of all segments, tell of it, write the report, and remove what they
    replace."""
    if len(files) > 1:
        _save(out / "scene.npz", result, report)
        name = f"the clip of {len(files)} segments"
        tell(summary_line(report, name) if "after" in report else "", quiet)
    write_json(out / REQUIREMENT_FILE, report)
    if len(files) > 1:
        _remove(files)


def _demand_same_segments(progress: RunProgress, count: int) -> None:
    """Refuse to resume with other segments than before."""
    if progress.segments != count:
        raise ValueError(
            f"fit.segment must cut the capture into {progress.segments} segments, as in the run "
            f"that is resumed, but it is cut into {count}."
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
