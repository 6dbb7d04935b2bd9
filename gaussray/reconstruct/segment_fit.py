"""One segment of a reconstruction: its stages, its pruning, and what is told of it."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool

from gaussray.camera.corrections import refined_kinds
from gaussray.camera.refined_cameras import (
    color_matrices,
    corrections_summary,
    gains,
    refined_frames,
)
from gaussray.capture.capture import Capture
from gaussray.dataset.manifest import FIT_SCALE, FrameRecord, write_manifest
from gaussray.reconstruct.backdrop_shell import with_backdrop_shell
from gaussray.reconstruct.checks.doubtful_views import doubtful_views
from gaussray.reconstruct.checks.failed_fit import demand_detail
from gaussray.reconstruct.checks.pose_check import warn_of_wrong_poses
from gaussray.reconstruct.initialize.impacts import with_impacts
from gaussray.reconstruct.loop import run_stage
from gaussray.reconstruct.motion import with_motion
from gaussray.reconstruct.optimize.rows import take_rows
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.simplify.candidate_meter import Tracing
from gaussray.reconstruct.simplify.prune import pruned_scene
from gaussray.reconstruct.simplify.summary import summary_line
from gaussray.reconstruct.simplify.tile_views import TrainingViews
from gaussray.reconstruct.start import continued_state, initial_state
from gaussray.reconstruct.work_ahead import work_ahead
from gaussray.runtime.errors import FitError
from gaussray.scene.deformation import Deformation
from gaussray.scene.scene import Scene
from gaussray.tracer.shard import mesh


def fitted_state(
    session: Session, state: State | None, progress: RunProgress
) -> tuple[State, RunProgress]:
    """The state after all stages that are left of a segment.

    Args:
        session: the segment's pictures, cameras and options.
        state: where to go on; None to begin.
        progress: the stage that the state is in.
    """
    session.shared.once("detail", lambda: demand_detail(session.footage))
    if not session.is_continuation:
        session.shared.once("poses", lambda: warn_of_wrong_poses(session.footage))
    if state is None:
        state, progress = initial_state(session, progress)
        with work_ahead(session, state, progress) as ready:
            state, progress = _before_fine(session, state, progress)
            ready(state)
    else:
        session.resume(state, progress)
        state, progress = _before_fine(session, state, progress)
    return (
        run_stage(session, "fine", state, progress) if len(session.times) > 1 else (state, progress)
    )


def _before_fine(
    session: Session, state: State, progress: RunProgress
) -> tuple[State, RunProgress]:
    """The state before the fine stage, or where it was left in that stage."""
    if progress.stage == "coarse":
        # Transient Gaussians are there at all times at once.
        fit = session.options.fit
        if fit.deforms or session.still_first or len(session.times) == 1:
            state, progress = run_stage(session, "coarse", state, progress)
        state, progress = with_motion(session, state, progress)
    elif progress.stage == "begin":
        state, progress = continued_state(session, state, progress)
        state, progress = with_motion(session, state, progress)
    return state, progress


def pruned_segment(
    session: Session, state: State, progress: RunProgress, devices: int | None
) -> tuple[Scene, dict[str, Any]]:
    """The scene of a fitted state after pruning, and the report.

    Args:
        session: the segment's pictures, cameras and options.
        state: the state after the last stage.
        progress: its progress, for the report.
        devices: how many devices measure; None for all.

    Raises:
        FitError: pruning failed; the fit is in the checkpoint.
    """
    scene, unmet = session.scene(state, progress)
    scene, unmet = _carved(session, scene, unmet)
    if session.backdrop is not None:
        eye = np.asarray(session.footage.camera.trajectory.translation).reshape(-1, 3)
        scene, unmet = with_backdrop_shell(scene, unmet, session.backdrop, eye)
    try:
        scene, report = pruned_scene(
            scene,
            TrainingViews(session.footage, *session.training_cameras(state)),
            options=session.options.prune,
            tracing=Tracing(session.options.trace, mesh(devices), session.key_states(state)),
            seed=session.options.fit.seed,
            unmet=unmet,
            report=session.progress_report("prune"),
        )
    except (ValueError, TypeError, ArithmeticError, LookupError) as error:
        if not session.options.prune.loss:
            raise
        why = str(error).rstrip(". ") or type(error).__name__
        raise FitError(
            f"pruning failed: {why}. The fit is in {session.log.checkpoint}: resumed (resume=true) "
            "with prune.loss=0, it is saved unpruned. GAUSSRAY_TRACEBACK=1 shows what failed."
        ) from error
    if session.equalization is not None:
        scene = replace(scene, light=session.equalization.light)
    if not session.shows_times_between and isinstance(scene.deformation, Deformation):
        bodies = with_impacts(scene.deformation.bodies)
        scene = eqx.tree_at(lambda s: s.deformation.bodies, scene, bodies)
    return scene, report


def write_refined_cameras(
    path: Path, session: Session, state: State, *, unscaled: Capture, scale: float
) -> None:
    """Write every camera of the capture as refined, what was refined, the gains and colour matrices
    that were found, and how much smaller the fitted pictures are.

    Corrections are relative to the focal length, so that they hold for pictures of any size.

    Args:
        path: the JSON file.
        session: the capture's cameras as they were fitted.
        state: the fitted state, for its corrections.
        unscaled: the capture, its pictures of the size that is written.
        scale: of the fitted pictures' sides.
    """
    corrections, names = state.parameters.corrections, session.names
    views = unscaled.views
    frames = [(view.camera_name, view.camera) for view in views]
    cameras = refined_frames(corrections, session.cameras, names, frames)
    records = [
        FrameRecord(str(view.image.resolve()), camera, view.camera_name, view.split)
        for view, camera in zip(views, cameras, strict=True)
    ]
    found = {
        "refined": list(refined_kinds(corrections)),
        "gain": gains(corrections, session.cameras, names),
        "color_matrix": color_matrices(corrections, session.cameras, names),
    }
    found = {key: value for key, value in found.items() if value}
    if scale < 1:
        found[FIT_SCALE] = scale
    write_manifest(path, records, extra={"info": found} if found else None)


def segment_sentences(
    session: Session, state: State, report: dict[str, Any], *, first: bool
) -> Iterator[str]:
    """What is told of a fitted segment: corrections of cameras (of the first one), pictures that it
    did not come near, what pruning did. Some are empty.

    Args:
        session: the segment's pictures, cameras and options.
        state: the fitted state.
        report: the report of pruning.
        first: whether it is the first segment, in which cameras are refined.
    """
    yield _found(session, state) if first else ""
    yield _doubtful(session)
    yield summary_line(report, session.name or "the scene") if "steps" in report else ""


def _found(session: Session, state: State) -> str:
    """What was found of the cameras, nothing if they are as recorded."""
    corrections = state.parameters.corrections
    if corrections is None:
        return ""
    shutter, unit = session.footage.camera.shutter, session.capture.time_unit
    return corrections_summary(corrections, session.cameras, shutter, unit)


def _doubtful(session: Session) -> str:
    """Training pictures that the fit did not come near, where errors are kept (fit.error_share)."""
    errors = session.loader.errors
    if errors is None:
        return ""
    _, first = np.unique(session.footage.viewpoints, return_index=True)
    return doubtful_views(session.footage.name[first].tolist(), errors.seen(first))


def _carved(
    session: Session, scene: Scene, unmet: Bool[np.ndarray, " gaussians"]
) -> tuple[Scene, Bool[np.ndarray, " kept"]]:
    """The scene without the static Gaussians outside the visual hull, and which of the others no
    ray has met: tiles that masks hide wholly are never drawn, but other cameras see what is there.
    """
    kept = ~session.outside(np.asarray(scene.static.mean))
    # Masks that leave none are wrong.
    if kept.all() or not kept.any():
        return scene, unmet
    scene = replace(scene, static=take_rows(scene.static, np.flatnonzero(kept)))
    return scene, np.concatenate([unmet[: len(kept)][kept], unmet[len(kept) :]])
