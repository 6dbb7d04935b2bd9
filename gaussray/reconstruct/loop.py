"""The training loop of a stage: blocks of steps; between them density control, log, checkpoint.

A new kind of density control is added in `optimize.density`.
"""

import math
from dataclasses import replace
from functools import partial

import numpy as np

from gaussray.color import LEAST_MSE, psnr_from_mse
from gaussray.reconstruct.block_sizes import BlockSizes
from gaussray.reconstruct.held_out import held_out_scorer
from gaussray.reconstruct.motion_budget import motion_budget
from gaussray.reconstruct.optimize.density import clone_split_prune, density_due, relocate_dead
from gaussray.reconstruct.optimize.free_space import without_near_gaussians
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.run_progress import RunProgress, StageSchedule
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.step import step_schedule, train_block
from gaussray.reconstruct.step_plan import FEWEST_STEPS, FEWEST_STILL_STEPS, StepPlan, TimedPlan
from gaussray.reconstruct.step_setup import (
    first_sizes,
    gaussian_count,
    known_sizes,
    saved_sizes,
    sizes_key,
    step_options,
)
from gaussray.runtime.devices import from_primary, replicate
from gaussray.runtime.progress import say


# Share of the minutes of a fit in which what stands still is fitted first.
_STILL_SHARE = 0.25
# What is noted of a stage that has ended: the fit.minutes that have time for its fewest steps, 0 if
# it had time for them.
_ENOUGH = "minutes for the fewest steps"


def run_stage(
    session: Session, stage: str, state: State, progress: RunProgress
) -> tuple[State, RunProgress]:
    """All steps that are left of a stage, in blocks of fit.block.

    Args:
        session: the segment.
        stage: coarse or fine.
        state: the state to begin or to go on with; its step tells how many steps are done.
        progress: the progress so far.

    Returns:
        State and progress after the last step.
    """
    fit, log, loader = session.options.fit, session.log, session.loader
    progress = replace(progress, stage=stage)
    plan = planned_steps(session, progress)
    bar, count = session.progress_bar(stage, plan.steps), gaussian_count(state)
    sizes: BlockSizes | None = None
    views, cameras = replicate((session.footage.camera, session.cameras), session.mesh)
    state, score = from_primary(state), held_out_scorer(session, stage, views, cameras)
    begun = sizes_key(session, stage, state)
    for done, batches in loader.blocks(stage, int(state.step), plan, fit.block):
        if sizes is None:
            bar.report(done, "loads or compiles its programs")
            sizes = known_sizes(session, stage, state, progress)
            sizes = sizes or first_sizes(session, state, batches)
        # Steps that leave the state anywhere else would compile twice.
        schedule = step_schedule(plan.schedule, fit.seed)
        state, drawn, schedule = replicate((state, batches, schedule), session.mesh)
        options = step_options(session, stage)
        while True:
            after, terms, error, needed, dropped = train_block(
                state, views, drawn, cameras, options=options, schedule=schedule, sizes=sizes
            )
            if not int(dropped):
                break
            # Nothing is lost: the block is discarded and run again with enough room.
            sizes = sizes.enlarged(needed)
        log.demand_finite(terms, state, after, progress)
        loader.note_errors(batches, np.asarray(error))
        saved = saved_sizes(stage, sizes)
        progress = replace(progress, sizes=saved, tile_errors=loader.tile_errors())
        state = _with_density_control(session, after, progress, before=done, schedule=plan.schedule)
        count = count if state is after else gaussian_count(state)
        done += len(batches.time)
        log.record(progress, done, terms, count)
        # A share of the tiles (fit.error_share) is drawn where the scene is worst.
        drawn = psnr_from_mse(terms["mse"], least=LEAST_MSE)
        bar.report(done, f"{drawn:.2f} dB on the tiles drawn")
        # Before all times are seen, tiles of the others tell nothing.
        passed = float(plan.schedule.share_at(done))
        told = score if loader.sees_all(stage, done, passed) else None
        if plan.after_block(done, told and partial(told, state, sizes)):
            bar.change_total(plan.steps)
            progress = plan.noted(progress)
            _say_changed(session, stage, plan, done)
        log.save_in_time(state, progress)
        if done >= plan.steps:
            break
    if isinstance(plan, TimedPlan):
        needed = _minutes_for_fewest(fit.minutes, plan) if plan.seconds_of_fewest else 0.0
        session.shared.note((_ENOUGH, stage, fit.minutes), needed)
    if sizes is not None:
        # Density control may have added rows.
        for key in (begun, sizes_key(session, stage, state)):
            session.shared.note(key, sizes)
    return from_primary(state), progress


def _say_changed(session: Session, stage: str, plan: StepPlan, done: int) -> None:
    """Say why a plan that has just changed ends where it does, if that is not the given time."""
    if session.quiet:
        return
    if plan.stopped == done:
        say(f"Held-out tiles no longer improve at step {done}: the fit ends at step {plan.steps}.")
    elif isinstance(plan, TimedPlan) and plan.seconds_of_fewest:
        minutes = session.options.fit.minutes
        before = session.shared.known((_ENOUGH, "coarse", minutes)) if stage == "fine" else None
        say(short_time_sentence(minutes, plan, stage, before or 0.0))


def _minutes_for_fewest(minutes: float, plan: TimedPlan) -> float:
    """The fit.minutes that have time for the fewest steps of a stage.

    Args:
        minutes: fit.minutes, of which the stage may get a share.
        plan: that of the stage, with `seconds_of_fewest`.
    """
    return math.ceil(10 * minutes * plan.seconds_of_fewest / plan.seconds) / 10


def short_time_sentence(minutes: float, plan: TimedPlan, stage: str, before: float) -> str:
    """What is said where the fewest steps of a stage take longer than it has.

    Args:
        minutes: fit.minutes, of which the stage may get a share.
        plan: that of the stage, with `seconds_of_fewest`.
        stage: its name, of one that gets a share.
        before: fit.minutes that have time for the stage before; 0 if that stage had enough time.
    """
    share, fewest = plan.seconds / 60, plan.seconds_of_fewest / 60
    who = "this stage"
    if share < minutes:
        who = f"the {stage} stage gets {_readable(share)} minutes of them, and"
    needed = max(_minutes_for_fewest(minutes, plan), before)
    return (
        f"fit.minutes={minutes:g} is too short: {who} takes about {_readable(fewest)} minutes for "
        f"{plan.steps} steps, its fewest. fit.minutes={needed:g} has time for "
        f"{'those of both stages' if before else 'them'}."
    )


def _readable(minutes: float) -> str:
    return f"{minutes:.2g}" if minutes < 10 else f"{minutes:.0f}"


def planned_steps(session: Session, progress: RunProgress) -> StepPlan:
    """The number of steps of the current stage.

    Where all pictures share one time there is one stage, which takes the steps of both, or as many
    as fit into fit.minutes. What stands still takes a share of these minutes where it is fitted
    first.

    Args:
        session: the segment.
        progress: the stage, and the steps planned before a run was interrupted.
    """
    fit, coarse = session.options.fit, progress.stage == "coarse"
    several = len(session.times) > 1
    if several and coarse and not (session.still_first and fit.minutes):
        return StepPlan(StageSchedule(fit.coarse))
    if progress.planned is not None:
        return StepPlan(progress.planned)
    if fit.minutes:
        share = (_STILL_SHARE if coarse else 1 - _STILL_SHARE) if session.still_first else 1.0
        fewest = FEWEST_STILL_STEPS if several and coarse else FEWEST_STEPS
        return TimedPlan(60 * fit.minutes * share, fit.block, fewest)
    return StepPlan(StageSchedule(fit.fine if several else fit.coarse + fit.fine))


def _with_density_control(
    session: Session, state: State, progress: RunProgress, *, before: int, schedule: StageSchedule
) -> State:
    """The state after density control, or the same state where it is not due."""
    options, done = session.options.density, int(state.step)
    if not density_due(options, before, done, float(schedule.share_at(done))):
        return state
    # What stands still leaves room for what moves.
    part = 2 if session.still_first and progress.stage == "coarse" else 1
    state = from_primary(state)
    if progress.free_space is not None:
        state = without_near_gaussians(state, progress.free_space)
    limit = progress.limit[0] // part, progress.limit[1] // part
    seed = session.options.fit.seed + 2 * done + (progress.stage == "fine")
    if options.relocates:
        # Rows that the devices share evenly.
        step, budget = 8 * session.mesh.size, motion_budget(session, progress.moved)
        most = {kind: -(-count // step) * step for kind, count in budget._asdict().items()}
        return relocate_dead(state, options=options, limit=sum(limit), most=most, seed=seed)
    return clone_split_prune(state, options=options, extent=session.extent, limit=limit, seed=seed)
