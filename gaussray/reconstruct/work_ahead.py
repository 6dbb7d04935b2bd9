"""Work that needs no result of the coarse stage, done by threads while that stage is fitted.

What moves is looked for in the pictures alone, and the program of the fine stage's steps depends on
the shapes of its arrays, not on their numbers: a thread runs a block of these steps on a few points
that stand in for those to come. Where their shapes were guessed wrong, steps compile as ever.
"""

import contextlib
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.reconstruct.auto.machine import this_machine
from gaussray.reconstruct.initialize.nonrigid_registration import registration_options
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.reconstruct.initialize.stereo.points import StereoPoints
from gaussray.reconstruct.initialize.transients import starting_times
from gaussray.reconstruct.motion import find_motion, first_deformation, first_transients
from gaussray.reconstruct.moving_clouds import by_pictures_alone
from gaussray.reconstruct.optimize.state import State, begin_state
from gaussray.reconstruct.run_progress import RunProgress, StageSchedule
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.step import step_schedule, train_block
from gaussray.reconstruct.step_setup import first_sizes, step_options
from gaussray.runtime.devices import cores, from_primary, replicate
from gaussray.runtime.side_by_side import beside
from gaussray.scene.control_points import ControlPoints


# Processors from which on threads do not keep the steps from them.
_CORES = 6
# Points that stand in for what moves at each time.
_POINTS = 16


@contextlib.contextmanager
def work_ahead(
    session: Session, state: State, progress: RunProgress
) -> Iterator[Callable[[State], None]]:
    """In this context threads find what moves, and compile the steps of the fine stage, where
    control points or transient Gaussians between cameras that stand still show motion, on a GPU.

    Args:
        session: the segment.
        state: the state before the coarse stage.
        progress: its progress.

    Returns:
        A function of the state before the fine stage: it waits for the program of such states, if
        that is being compiled.
    """
    fit = session.options.fit
    soft = fit.transient and (fit.control or not fit.deforms) and not session.still_first
    density = session.options.density
    # With less room than for a few of the points of each time, there is little to wait for.
    soft = soft and density.relocates and density.gaussians > 4 * _POINTS * fit.instants
    key = "ahead", fit.motion, fit.refine
    if session.shared.known(key) or not (
        soft and works_ahead(session.mesh.size) and by_pictures_alone(session, None)
    ):
        yield lambda state: None
        return
    # Fits of the same pictures share what is found and compiled.
    session.shared.note(key, True)
    expected: Future[Any] = Future()

    def compiled() -> None:
        guess = stand_in_state(session, state, progress)
        expected.set_result(shapes(guess))
        run_block(session, guess)

    def ready(state: State) -> None:
        wait([expected, program], return_when=FIRST_COMPLETED)
        if expected.done() and expected.result() == shapes(state):
            # What fails in it fails again, and is told, where its result is needed.
            wait([program])

    with beside([lambda: find_motion(session, state.parameters), compiled]) as (_, program):
        yield ready


def works_ahead(devices: int) -> bool:
    """Whether one GPU has the memory for steps of both stages, and there are processors to work
    ahead with."""
    return this_machine(devices).runs_two_fits and cores() >= _CORES


def shapes(state: State) -> Hashable:
    """What programs depend on of a state.

    Args:
        state: a state of any numbers.
    """
    leaves, structure = jax.tree.flatten(state)
    return structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)


def run_block(session: Session, state: State) -> None:
    """Run a block of steps of the fine stage, which compiles what those of such a state run.

    Args:
        session: the segment.
        state: a state of any numbers.
    """
    fit = session.options.fit
    batches = session.loader.batches("fine", 0, fit.block, 0.0)
    sizes = first_sizes(session, state, batches)
    schedule = step_schedule(StageSchedule(fit.block), fit.seed)
    known = (from_primary(state), session.footage.camera, batches, session.cameras, schedule)
    state, views, drawn, cameras, schedule = replicate(known, session.mesh)
    options = step_options(session, "fine")
    result = train_block(
        state, views, drawn, cameras, options=options, schedule=schedule, sizes=sizes
    )
    jax.block_until_ready(result)


def stand_in_state(session: Session, state: State, progress: RunProgress) -> State:
    """A state whose arrays are as large as those before the first step of the fine stage most
    likely are.

    Args:
        session: the segment.
        state: the state before the coarse stage.
        progress: its progress.
    """
    fit, parameters = session.options.fit, state.parameters
    clouds, deformation = _stand_in_clouds(session), None
    if fit.deforms:
        control = _stand_in_control_points(clouds) if fit.control else None
        deformation = first_deformation(session, parameters, progress, control)
    transient = first_transients(session, clouds, None)
    return begin_state(
        replace(parameters, deformation=deformation, transient=transient, shading=None)
    )


def _stand_in_clouds(session: Session) -> list[MovingPoints]:
    """A few points at each of the times at which transient Gaussians start."""
    place = np.random.default_rng(0).normal(size=(_POINTS, 3)).astype(np.float32)
    one = np.ones(_POINTS, np.float32)
    points = StereoPoints(place, np.zeros_like(place), np.full_like(place, 0.5), one, one, one)
    times = starting_times(session.times, session.options.fit.instants)
    return [MovingPoints(points, time, np.zeros_like(place), one) for time in times.tolist()]


def _stand_in_control_points(clouds: list[MovingPoints]) -> ControlPoints:
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
