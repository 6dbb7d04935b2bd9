"""The training loop of a stage: blocks of steps; between them density control, log, checkpoint.

A new kind of density control is added in `optimize.density`.
"""

from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import cache, partial

import jax
import numpy as np
from jaxtyping import Bool

from gaussray.camera.array import CameraSet, rays_per_pixel
from gaussray.camera.camera import Camera
from gaussray.color import LEAST_MSE, psnr_from_mse
from gaussray.reconstruct.data.batches import Batch
from gaussray.reconstruct.data.held_out_tiles import held_out_batches
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.held_out import held_out_psnr
from gaussray.reconstruct.optimize.density import density_control, density_due
from gaussray.reconstruct.optimize.free_space import without_haze
from gaussray.reconstruct.optimize.rows import occupied
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.run_progress import Course, RunProgress, SavedSizes
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.step import measure_sizes, schedule, train_block
from gaussray.reconstruct.step_loss import BlockSizes, StepOptions
from gaussray.reconstruct.step_plan import StepPlan, TimedPlan
from gaussray.runtime.devices import agreed, everywhere
from gaussray.runtime.progress import say
from gaussray.tracer.options import grid_levels
from gaussray.tracer.traverse import Capacity


# Share of the minutes of a fit in which what stands still is fitted first.
_STILL_SHARE = 0.25
# Sizes of what tiles see: persistent and transient Gaussians.
_SEEN = 2


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
    bar, count = session.progress_bar(stage, plan.steps), _gaussian_count(state)
    sizes: BlockSizes | None = None
    views, cameras = everywhere((session.footage.camera, session.cameras), session.mesh)
    state, score = agreed(state), _held_out_score(session, stage, views, cameras)
    begun = _sizes_key(session, stage, state)
    for done, batches in loader.blocks(stage, int(state.step), plan, fit.block):
        if sizes is None:
            bar.report(done, "loads or compiles its programs")
            sizes = _known_sizes(session, stage, state, progress)
            sizes = sizes or first_sizes(session, state, batches)
        # Steps that leave the state anywhere else would compile twice.
        course = schedule(plan.course, fit.seed)
        state, drawn, course = everywhere((state, batches, course), session.mesh)
        options = step_options(session, stage)
        while True:
            after, terms, error, needed, dropped = train_block(
                state, views, drawn, cameras, options=options, schedule=course, sizes=sizes
            )
            if not int(dropped):
                break
            # Nothing is lost: the block is discarded and run again with enough room.
            sizes = sizes.enlarged(needed)
        log.demand_finite(terms, state, after, progress)
        loader.note_errors(batches, np.asarray(error))
        progress = replace(progress, sizes=_to_save(stage, sizes), tile_errors=loader.tile_errors())
        state = _with_density_control(session, after, progress, before=done, course=plan.course)
        count = count if state is after else _gaussian_count(state)
        done += len(batches.time)
        log.record(progress, done, terms, count)
        bar.report(done, f"{psnr_from_mse(terms['mse'], least=LEAST_MSE):.2f} dB")
        # Before all times are seen, tiles of the others tell nothing.
        told = score if loader.sees_all(stage, done, plan.steps) else None
        if plan.after_block(done, told and partial(told, state, sizes)):
            bar.change_total(plan.steps)
            progress = plan.noted(progress)
            _say_stopped(session, plan, done)
        log.save_in_time(state, progress)
        if done >= plan.steps:
            break
    if sizes is not None:
        # Density control may have added rows.
        for key in (begun, _sizes_key(session, stage, state)):
            session.shared.note(key, sizes)
    return agreed(state), progress


def _held_out_score(
    session: Session, stage: str, views: Camera, cameras: CameraSet
) -> Callable[[State, BlockSizes], float] | None:
    """The PSNR of the held-out tiles as a function of the state; None if there are none."""
    if session.held_out is None:
        return None
    held, options = session.held_out, step_options(session, stage)

    @cache
    def batches() -> list[Batch]:
        # Only timed stages look at them.
        return held_out_batches(session.footage, held, session.options.fit.tiles)

    def score(state: State, sizes: BlockSizes) -> float:
        known = everywhere(state, session.mesh)
        return held_out_psnr(known, views, batches(), cameras, options=options, sizes=sizes)

    return score


def held_out_score(
    session: Session,
    state: State,
    seen: Footage | None = None,
    held: Bool[np.ndarray, "frames tiles"] | None = None,
) -> float:
    """PSNR in dB of tiles that no step has drawn, after a fit.

    Args:
        session: the segment.
        state: what is scored.
        seen: the training pictures, perhaps with fewer pixels that count; None: those of the
            session.
        held: the tiles; None: those that the session holds out.

    Raises:
        ValueError: there are no such tiles.
    """
    seen, held = seen or session.footage, session.held_out if held is None else held
    if held is None or not held.any():
        raise ValueError("fit.validate must be above 0 for tiles to be held out.")
    views, cameras = everywhere((session.footage.camera, session.cameras), session.mesh)
    batches = held_out_batches(seen, held, session.options.fit.tiles)
    sizes = session.shared.known(_sizes_key(session, "fine", state))
    sizes = sizes or first_sizes(session, state, jax.tree.map(lambda *x: np.stack(x), *batches))
    known, options = everywhere(agreed(state), session.mesh), step_options(session, "fine")
    return held_out_psnr(known, views, batches, cameras, options=options, sizes=sizes, enlarge=True)


def _say_stopped(session: Session, plan: StepPlan, done: int) -> None:
    if plan.stopped == done and not session.quiet:
        say(f"Held-out tiles no longer improve at step {done}: the fit ends at step {plan.steps}.")


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
        return StepPlan(Course(fit.coarse))
    if progress.planned is not None:
        return StepPlan(progress.planned)
    if fit.minutes:
        share = (_STILL_SHARE if coarse else 1 - _STILL_SHARE) if session.still_first else 1.0
        return TimedPlan(60 * fit.minutes * share, fit.block)
    return StepPlan(Course(fit.fine if several else fit.coarse + fit.fine))


def step_options(session: Session, stage: str) -> StepOptions:
    """The options of the steps of a stage.

    In the coarse stage of a scene that moves, only what cameras make of colours is refined: the
    scene is not formed yet and would form around the cameras' errors. After the first segment the
    cameras are known.

    Args:
        session: the segment.
        stage: coarse or fine.
    """
    options, refine = session.options, session.options.fit.refine
    if session.is_continuation:
        refine = ()
    elif stage == "coarse" and len(session.times) > 1:
        refine = tuple(kind for kind in refine if kind in ("exposure", "color_matrix"))
    return StepOptions(
        options.loss,
        options.optimizer,
        options.trace,
        samples=options.fit.samples or rays_per_pixel(session.footage.camera),
        footprint=options.fit.footprint,
        refine=refine,
        formed=session.is_continuation,
        degree_interval=options.fit.degree_interval,
        density=options.density,
        backdrop=session.backdrop,
        still=stage == "coarse" and session.still_first,
        at_rest=session.at_rest,
    )


def first_sizes(session: Session, state: State, batches: Batch) -> BlockSizes:
    """The sizes to compile the steps of a stage for, with room for what density control adds.

    Gaussians that replace each other are smaller, so lists grow more slowly than their number.

    Args:
        session: the segment.
        state: the state before the first step.
        batches: the tiles of a block, of which the first step is measured.
    """
    mesh, keys, density = session.mesh, session.key_states(state), session.options.density
    count = _gaussian_count(state)
    sizes = measure_sizes(
        state,
        session.footage.camera,
        batches,
        session.cameras,
        options=step_options(session, "fine"),
        mesh=mesh,
        keys=keys,
        growth=(density.room(count) / max(count, 1)) ** 0.5 if density.interval else 1.0,
    )
    return _sizes([int(n) for n in agreed(np.array(_numbers(sizes)))], session, state)


def _known_sizes(
    session: Session, stage: str, state: State, progress: RunProgress
) -> BlockSizes | None:
    """The sizes that an interrupted run was compiled for, or an earlier fit of the same pictures,
    so that this one goes on with the same programs; None where none are known for this stage and
    as many devices."""
    saved = progress.sizes
    if saved is None or not int(state.step):
        return session.shared.known(_sizes_key(session, stage, state))
    levels = session.options.trace.levels + 1 if saved.levels is None else saved.levels
    here = progress.stage, session.mesh.size, _levels(session)
    if (saved.stage, saved.devices, levels) != here:
        return None
    if len(saved.sizes) not in (n := _least_numbers(session, state), n + _SEEN):
        return None
    return _sizes(list(saved.sizes), session, state)


def _sizes_key(session: Session, stage: str, state: State) -> tuple[Hashable, ...]:
    """What decides which sizes the steps of a stage need: the rows of each kind of Gaussians, and
    what a step draws of them."""
    rows = tuple(len(part.mean) for part in state.parameters.kinds.values())
    options, keys = session.options, session.key_states(state)
    return "sizes", stage, rows, options.fit.tiles, options.fit.tile_side, options.trace, keys


def _to_save(stage: str, sizes: BlockSizes) -> SavedSizes:
    levels = len(sizes.capacity.cells)
    return SavedSizes(stage, sizes.mesh.size, levels, tuple(_numbers(sizes)))


def _numbers(sizes: BlockSizes) -> list[int]:
    """All sizes in a row: lists, transient Gaussians if there are any, and what tiles see."""
    capacity = sizes.capacity
    transient = [capacity.transient] if capacity.transient else []
    return [*capacity.cells, capacity.pairs, capacity.slots, *transient, *(sizes.seen or ())]


def _least_numbers(session: Session, state: State) -> int:
    """How many `_numbers` there are without those of what tiles see."""
    transient = state.parameters.transient is not None
    return _levels(session) + 2 + transient


def _levels(session: Session) -> int:
    """For how many levels of bundles a step finds cells."""
    return grid_levels(session.options.trace, session.footage.camera.time.dtype)


def _sizes(numbers: list[int], session: Session, state: State) -> BlockSizes:
    """The sizes of which `_numbers` gives the numbers."""
    levels, least = _levels(session), _least_numbers(session, state)
    capacity = Capacity(tuple(numbers[:levels]), *numbers[levels:least])
    seen = (numbers[-2], numbers[-1]) if len(numbers) > least else None
    return BlockSizes(capacity, session.mesh, session.key_states(state), seen)


def _with_density_control(
    session: Session, state: State, progress: RunProgress, *, before: int, course: Course
) -> State:
    """The state after density control, or the same state where it is not due."""
    options, done = session.options.density, int(state.step)
    if not density_due(options, before, done, float(course.share_at(done))):
        return state
    # What stands still leaves room for what moves.
    part = 2 if session.still_first and progress.stage == "coarse" else 1
    state = agreed(state)
    if progress.free_space is not None:
        state = without_haze(state, progress.free_space)
    return density_control(options)(
        state,
        options=options,
        extent=session.extent,
        limit=(progress.limit[0] // part, progress.limit[1] // part),
        seed=session.options.fit.seed + 2 * done + (progress.stage == "fine"),
    )


def _gaussian_count(state: State) -> int:
    """How many Gaussians a state has."""
    return sum(int(occupied(part).sum()) for part in state.parameters.kinds.values())
