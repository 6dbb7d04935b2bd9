"""Stage 1: pictures become a scene."""

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from gaussray.camera.refined_cameras import (
    color_matrices,
    corrections_summary,
    gains,
    refined_frames,
)
from gaussray.capture.capture import Capture
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.io.atomic import sweep, whole
from gaussray.reconstruct.auto.effort import effort
from gaussray.reconstruct.auto.machine import this_machine
from gaussray.reconstruct.auto.motion_choice import rivals_of, with_motion_tried
from gaussray.reconstruct.auto.refinement_trial import with_refinement_tried
from gaussray.reconstruct.auto.trial_fits import TrialFits, remove_killed_trials
from gaussray.reconstruct.backdrop_shell import with_backdrop_shell
from gaussray.reconstruct.checks.covered_cameras import without_covered_cameras
from gaussray.reconstruct.checks.doubtful_views import doubtful_views
from gaussray.reconstruct.checks.failed_fit import demand_detail, demand_success, warn_of_one_place
from gaussray.reconstruct.checks.pose_check import warn_of_wrong_poses
from gaussray.reconstruct.data.common_times import common_times_sentence, with_common_times
from gaussray.reconstruct.data.segments import segments
from gaussray.reconstruct.data.training_split import demand_training_pictures
from gaussray.reconstruct.initialize.impacts import with_impacts
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.loop import run_stage
from gaussray.reconstruct.motion import with_motion
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.options import ReconstructOptions as ReconstructOptions
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.session import Session, hand_over
from gaussray.reconstruct.shared_results import SharedResults
from gaussray.reconstruct.simplify.measure import Tracing, TrainingViews
from gaussray.reconstruct.simplify.prune import pruned_scene
from gaussray.reconstruct.simplify.summary import clip_report, summary_line
from gaussray.reconstruct.start import continued_state, initial_state
from gaussray.runtime.devices import leads, wait
from gaussray.runtime.lock import locks_output
from gaussray.runtime.progress import say
from gaussray.scene.deformation import Deformation
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.scene.store import load_scene, save_scene, scene_info
from gaussray.tracer.shard import mesh


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
    report of pruning), cameras.json (the cameras as refined), and, while the run lasts,
    checkpoint.npz; and motion.json and refine.json, the scores of trials, if there were any.

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
            other segments or refined other parameters of the cameras.
        FileNotFoundError: there is no run to resume.
        NonFiniteLoss: the loss or a parameter became infinite or not a number.
        FailedFit: the fit ended below what one colour per camera scores, or with an empty scene.
        CaptureError: there are no training pictures, or they cannot be used together.
    """
    demand_training_pictures(capture)
    options = ReconstructOptions() if options is None else options
    recorded = without_covered_cameras(capture)
    capture = with_common_times(recorded)
    common = common_times_sentence(recorded, capture)
    out, interval = Path(out), options.fit.checkpoint
    log = RunLog(out, resume=resume, interval=interval, writes=leads(), listener=listener)
    machine = this_machine(devices)
    chosen = effort(capture, options, machine)
    rivals = rivals_of(capture, options, machine, chosen.rivals)
    # A trial compares the same pictures, the smallest that one of its fits would take.
    tried = min((chosen, *rivals.values()), key=lambda choice: choice.scale)
    warn_of_one_place(capture)
    course = segments(tried.capture, options.fit.segment)
    if leads():
        sweep(out, deep=len(course) > 1)
        remove_killed_trials(out)

    def told(line: str) -> None:
        _say(line, quiet or not leads())

    told(common)
    fits = TrialFits(
        tried.capture,
        course[0],
        out,
        _fitted,
        SharedResults(),
        devices,
        quiet or not leads(),
        at_once=machine.runs_two_fits,
    )
    chosen, scores = with_motion_tried(
        fits, chosen, rivals, steps=machine.trial_steps, resume=resume, say=told
    )
    told(chosen.sentence)
    if chosen.scale != tried.scale:
        course = segments(chosen.capture, options.fit.segment)
        fits = replace(fits, capture=chosen.capture, segment=course[0], shared=SharedResults())
    capture, shared = chosen.capture, fits.shared
    options = with_refinement_tried(fits, chosen.options, resume=resume, say=told)
    # It holds the pictures of the first segment.
    del fits
    state, progress = log.resumed() if resume else (None, RunProgress(segments=len(course)))
    _demand_same_segments(progress, len(course))
    files = [out / "segments" / f"{i:04d}.npz" for i in range(1, len(course) + 1)]
    files = files if len(files) > 1 else [out / "scene.npz"]
    finished = files[: progress.segment - 1]
    scenes: list[Any] = [load_scene(path) for path in finished]
    reports = [scene_info(path) for path in finished]
    for i in range(len(finished), len(course)):
        session = Session(
            capture, log, options, quiet or not leads(), devices, course[i], shared=shared
        )
        _say(session.equalization.sentence if session.equalization else "", session.quiet)
        state, progress = _fitted(session, state, progress)
        scene, report = _pruned(session, state, progress, devices)
        report |= {"trial": scores} if scores else {}
        demand_success(scene, report, capture, options.fit.start)
        if leads():
            _save(files[i], scene, report)
            if i == 0:
                _write_cameras(out / "cameras.json", session, state)
        _say(_found(session, state) if i == 0 else "", session.quiet)
        _say(_doubtful(session), session.quiet)
        line = summary_line(report, session.name or "the scene") if "steps" in report else ""
        _say(line, session.quiet)
        scenes.append(scene)
        reports.append(report)
        if i + 1 < len(course):
            state, progress = hand_over(session, state, progress)
            log.save(state, progress)
        # Its pictures make room for those of the next segment.
        del session
        shared = SharedResults()
    result, report = scenes[0], reports[0]
    if len(course) > 1:
        result, report = Clip(tuple(scenes)), clip_report(reports)
        if leads():
            _save(out / "scene.npz", result, report)
        whole_clip = f"the clip of {len(course)} segments"
        _say(summary_line(report, whole_clip) if "after" in report else "", quiet or not leads())
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
    session.shared.once("detail", lambda: demand_detail(session.footage))
    if not session.later:
        session.shared.once("poses", lambda: warn_of_wrong_poses(session.footage))
    if state is None:
        state, progress = initial_state(session, progress)
    else:
        session.resume(state, progress)
    if progress.stage == "coarse":
        # Transient Gaussians are there at all times at once.
        fit = session.options.fit
        if fit.deforms or session.still_first or len(session.times) == 1:
            state, progress = run_stage(session, "coarse", state, progress)
        state, progress = with_motion(session, state, progress)
    elif progress.stage == "begin":
        state, progress = continued_state(session, state, progress)
        state, progress = with_motion(session, state, progress)
    return (
        run_stage(session, "fine", state, progress) if len(session.times) > 1 else (state, progress)
    )


def _pruned(
    session: Session, state: State, progress: RunProgress, devices: int | None
) -> tuple[Scene, dict[str, Any]]:
    """The scene of a fitted state after pruning, and the report."""
    scene, unmet = session.scene(state, progress)
    if session.backdrop is not None:
        eye = np.asarray(session.footage.camera.trajectory.translation).reshape(-1, 3)
        scene, unmet = with_backdrop_shell(scene, unmet, session.backdrop, eye)
    scene, report = pruned_scene(
        scene,
        TrainingViews(session.footage, *session.training_cameras(state)),
        options=session.options.need,
        tracing=Tracing(session.options.trace, mesh(devices), session.key_states(state)),
        seed=session.options.fit.seed,
        unmet=unmet,
        report=session.progress_report("need", patience=2.0),
    )
    if session.equalization is not None:
        scene = replace(scene, light=session.equalization.light)
    if not session.shows_times_between and isinstance(scene.deformation, Deformation):
        bodies = with_impacts(scene.deformation.bodies)
        scene = eqx.tree_at(lambda s: s.deformation.bodies, scene, bodies)
    return scene, report


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
    """Write every camera of the capture as refined, and the gains and colour matrices that were
    found."""
    corrections, names = state.parameters.corrections, session.names
    views = session.capture.views
    frames = [(view.camera_name, view.camera) for view in views]
    cameras = refined_frames(corrections, session.cameras, names, frames)
    records = [
        FrameRecord(str(view.image.resolve()), camera, view.camera_name, view.split)
        for view, camera in zip(views, cameras, strict=True)
    ]
    found = {
        "gain": gains(corrections, session.cameras, names),
        "color_matrix": color_matrices(corrections, session.cameras, names),
    }
    found = {key: value for key, value in found.items() if value}
    write_manifest(path, records, extra={"info": found} if found else None)


def _found(session: Session, state: State) -> str:
    """What was found of the cameras, nothing if they are as recorded."""
    corrections = state.parameters.corrections
    if corrections is None:
        return ""
    shutter, unit = session.footage.camera.shutter, session.capture.time_unit
    return corrections_summary(corrections, session.cameras, shutter, unit)


def _doubtful(session: Session) -> str:
    """Which training pictures the fit did not come near, where errors are kept (fit.error)."""
    errors = session.loader.errors
    if errors is None:
        return ""
    _, first = np.unique(session.footage.viewpoints, return_index=True)
    return doubtful_views(session.footage.name[first].tolist(), errors.seen(first))


def _say(line: str, quiet: bool) -> None:
    if line and not quiet:
        say(line)
