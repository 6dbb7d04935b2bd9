"""The programs of the steps, compiled by a thread while stereo still looks for points.

A program depends on the shapes of its arrays, not on their numbers. On a GPU the shapes of a fit
are known before its points: there are rows for the whole budget. So a thread runs a block of steps
on a few Gaussians that stand in for those to come. Where it guessed wrong, steps compile as ever.
"""

import contextlib
from collections.abc import Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.camera.corrections import no_corrections
from gaussray.reconstruct.initialize.from_points import on_points
from gaussray.reconstruct.initialize.nonrigid_registration import registration_options
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.reconstruct.initialize.stereo.points import StereoPoints
from gaussray.reconstruct.initialize.transients import starting_times
from gaussray.reconstruct.motion import first_deformation, first_transients
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import State, begin_state
from gaussray.reconstruct.run_progress import RunProgress, StageSchedule
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.start import with_room
from gaussray.reconstruct.step import step_schedule, train_block
from gaussray.reconstruct.step_setup import first_sizes, step_options
from gaussray.runtime.devices import cores, from_primary, replicate
from gaussray.scene.control_points import ControlPoints


# Processors from which on compiling in a thread does not keep stereo from them.
_CORES = 6
# Gaussians that stand in for static ones, and for what moves, there and at each time.
_STATIC, _MOVING = 48, 16


class ProgramsAhead:
    """Compiles the programs of a segment's steps in a thread, stage after stage.

    Args:
        session: the segment.
        stages: the stages whose programs are compiled, in their order.
    """

    def __init__(self, session: Session, stages: Sequence[str]):
        self._session = session
        self._threads = ThreadPoolExecutor(1, "ahead")
        self._expected: dict[str, Hashable] = {}
        self._begun = {stage: self._threads.submit(self._compile, stage) for stage in stages}

    def wait_for(self, stage: str, state: State) -> None:
        """Wait until the programs of a stage are compiled, if that has begun, and for such a state.

        Args:
            stage: coarse or fine.
            state: the state before the first step of the stage.
        """
        begun = self._begun.get(stage)
        if begun is not None and not begun.cancel() and self._expected.get(stage) == shapes(state):
            begun.result()

    def end(self) -> None:
        """Begin nothing more."""
        self._threads.shutdown(wait=False, cancel_futures=True)

    def _compile(self, stage: str) -> None:
        # What fails here fails again, and is told, where it matters.
        with contextlib.suppress(Exception):
            state = stand_in(self._session, stage)
            self._expected[stage] = shapes(state)
            run_block_ahead(self._session, stage, state)


def shapes(state: State) -> Hashable:
    """What programs depend on of a state.

    Args:
        state: a state of any numbers.
    """
    leaves, structure = jax.tree.flatten(state)
    return structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)


def programs_ahead(session: Session) -> ProgramsAhead:
    """Begins to compile the programs of a segment's steps, where their shapes are known before its
    points: on a GPU, with relocation under a budget, for Gaussians that stand still, and for
    control points and transient Gaussians between cameras that stand still.

    Args:
        session: the segment, before its first step.
    """
    fit, stages = session.options.fit, ()
    alone = session.mesh.size == 1 and jax.process_count() == 1
    if compiles_ahead() and alone and session.options.density.relocates:
        soft = fit.transient and not session.still_first and session.has_videos
        if len(session.times) == 1:
            stages = ("coarse",)
        elif soft and fit.control:
            stages = "coarse", "fine"
        elif soft and not fit.deforms:
            stages = ("fine",)
    # Fits of the same pictures share their programs.
    tried = [stage for stage in stages if not session.shared.known(("ahead", stage, fit.motion))]
    for stage in tried:
        session.shared.note(("ahead", stage, fit.motion), True)
    return ProgramsAhead(session, tried)


def compiles_ahead() -> bool:
    """Whether this machine has processors to compile with while stereo works."""
    return jax.default_backend() == "gpu" and cores() >= _CORES


def run_block_ahead(session: Session, stage: str, state: State) -> None:
    """Run a block of steps, which compiles what steps of such a state run.

    Args:
        session: the segment, before its first step.
        stage: coarse or fine.
        state: a state of any numbers.
    """
    fit = session.options.fit
    batches = session.loader.batches(stage, 0, fit.block, fit.block)
    sizes = first_sizes(session, state, batches)
    schedule = step_schedule(StageSchedule(fit.block), fit.seed)
    known = (from_primary(state), session.footage.camera, batches, session.cameras, schedule)
    state, views, drawn, cameras, schedule = replicate(known, session.mesh)
    options = step_options(session, stage)
    result = train_block(
        state, views, drawn, cameras, options=options, schedule=schedule, sizes=sizes
    )
    jax.block_until_ready(result)


def stand_in(session: Session, stage: str) -> State:
    """A state whose arrays are as large as those of the first step of a stage most likely are.

    Args:
        session: the segment.
        stage: coarse or fine.
    """
    fit, density = session.options.fit, session.options.density
    moving = _MOVING if fit.deforms and len(session.times) > 1 else 0
    moves = np.arange(_STATIC + moving) >= _STATIC
    place = _places(session, len(moves))
    gaussians = on_points(
        place,
        np.full_like(place, 0.5),
        degree=fit.degree,
        opacity=fit.initial_opacity,
        spread=fit.initial_scale,
    )
    progress = RunProgress(initial=(_STATIC, moving), most=density.room(len(moves)))
    corrections = no_corrections(fit.refine, len(session.names), session.footage.camera)
    state, progress = with_room(session, gaussians, moves, corrections, progress)
    if stage == "coarse" or len(session.times) == 1:
        return state
    parameters, deformation = state.parameters, None
    clouds = _clouds(session)
    if fit.deforms:
        control = _control_points(clouds) if fit.control else None
        deformation = first_deformation(session, parameters, progress, control)
    transient = first_transients(session, clouds, None)
    kinds = parameters.static, parameters.moving
    return begin_state(Parameters(*kinds, deformation, corrections, transient, None))


def _places(session: Session, count: int) -> Float[np.ndarray, "places 3"]:
    """Random places about the cameras."""
    eye = np.asarray(session.footage.camera.trajectory.translation).reshape(-1, 3)
    dice = np.random.default_rng(0)
    around = session.extent * dice.normal(size=(count, 3))
    return (eye.mean(axis=0) + around).astype(np.float32)


def _clouds(session: Session) -> list[MovingPoints]:
    """A few points at each of the times at which transient Gaussians start."""
    place, one = _places(session, _MOVING), np.ones(_MOVING, np.float32)
    points = StereoPoints(place, np.zeros_like(place), np.full_like(place, 0.5), one, one, one)
    times = starting_times(session.times, session.options.fit.instants)
    return [MovingPoints(points, time, np.zeros_like(place), one) for time in times.tolist()]


def _control_points(clouds: list[MovingPoints]) -> ControlPoints:
    """As many control points as are tracked on a surface, at rest."""
    count = registration_options(jax.default_backend()).control
    place = np.resize(clouds[0].points.position, (count, 3))
    time = np.array([cloud.time for cloud in clouds], np.float32)
    still = np.zeros((count, len(time), 4), np.float32)
    still[..., 0] = 1
    return ControlPoints(
        pivot=jnp.asarray(place),
        radius=jnp.asarray(np.full(count, 1.0, np.float32)),
        time=jnp.asarray(time),
        path=jnp.asarray(still[..., 1:]),
        turn=jnp.asarray(still),
    )
