"""The state before the first step: where the first Gaussians stand, and which of them may move.

A new kind of initialiser is added in `initialize.initializer.initial_points`.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from gaussray.camera.corrections import Corrections, no_corrections
from gaussray.geometry import rotation_matrix
from gaussray.reconstruct.data.motion_mask import point_activity
from gaussray.reconstruct.initialize.body_tracking import MovingGaussians, track
from gaussray.reconstruct.initialize.from_points import bodies, on_points, surrounding, thinned
from gaussray.reconstruct.initialize.initializer import initial_points
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.rows import occupied, take_rows, with_rows
from gaussray.reconstruct.optimize.state import State, begin_state
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.session import Session
from gaussray.runtime.devices import agreed
from gaussray.scene.bodies import Bodies, body_of, reaching
from gaussray.scene.deformation import initial_deformation
from gaussray.scene.gaussians import Gaussians, Unconstrained, constrain, unconstrain
from gaussray.scene.harmonics import C0
from gaussray.scene.planes import initial_planes


def initial_state(session: Session, progress: RunProgress) -> tuple[State, RunProgress]:
    """The state before the coarse stage, and the progress with the numbers of Gaussians.

    Gaussians stand on the points of an initialiser and on random ones around these. Which of them
    may move is decided here, so that static and moving Gaussians keep their rows.
    """
    fit = session.options.fit
    position, color, on_surfaces = initial_points(
        session.capture, session.footage, fit, session.progress_bar
    )
    if session.options.density.relocates:
        room = int(session.options.density.gaussians / (1 + on_surfaces * fit.surround))
        position, color = thinned(position, color, count=max(room, 1), seed=fit.seed)
    gaussians = on_points(
        position, color, degree=fit.degree, opacity=fit.opacity, spread=fit.spread
    )
    moves = _moves(session, position, on_surfaces=on_surfaces)
    initial = _counts(moves) if on_surfaces else (0, 0)
    count = round(fit.surround * len(position)) if on_surfaces else 0
    if count:
        around = surrounding(position, count=count, seed=fit.seed)
        more = on_points(*around, degree=fit.degree, opacity=0.5, flat=1.0)
        gaussians = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), gaussians, more)
        moves = np.concatenate([moves, np.zeros(count, bool)])
    most = session.options.density.room(len(moves))
    progress = replace(progress, initial=initial, most=most)
    corrections = no_corrections(fit.refine, len(session.names), session.footage.camera)
    return _with_room(session, gaussians, moves, corrections, progress)


def continued_state(
    session: Session, state: State, progress: RunProgress
) -> tuple[State, RunProgress]:
    """The state before the fine stage of a later segment, from what the one before handed over.

    The Gaussians whose pixels change in this segment may move now.
    """
    static = state.parameters.static
    gaussians = constrain(take_rows(static, np.flatnonzero(occupied(static))))
    moves = _moves(session, np.asarray(gaussians.mean), on_surfaces=True)
    progress = replace(progress, initial=_counts(moves))
    return _with_room(session, gaussians, moves, state.parameters.corrections, progress)


def _counts(moves: Bool[np.ndarray, " gaussians"]) -> tuple[int, int]:
    """How many are static, and how many move."""
    return int((~moves).sum()), int(moves.sum())


def _moves(
    session: Session, position: Float[np.ndarray, "points 3"], *, on_surfaces: bool
) -> Bool[np.ndarray, " points"]:
    """Which Gaussians may move. Random points say nothing of what moves: then all may."""
    if len(session.times) == 1:
        return np.zeros(len(position), bool)
    changing = point_activity(session.footage, position) > session.options.fit.moving
    moves = np.array(agreed(changing))
    if not on_surfaces or not session.has_videos:
        moves[:] = True
    return moves


def _with_room(
    session: Session,
    gaussians: Gaussians,
    moves: Bool[np.ndarray, " gaussians"],
    corrections: Corrections | None,
    progress: RunProgress,
) -> tuple[State, RunProgress]:
    """The state of these Gaussians, in arrays with rows for those that density control may add."""
    growth = max(progress.most / max(len(moves), 1), 1.0)
    limit = tuple(int(count * growth) for count in _counts(moves))
    rows_growth = growth if session.options.density.interval else 1.0
    # A multiple of 8 on every device.
    step = 8 * session.mesh.size

    def part(chosen: Bool[np.ndarray, " gaussians"]) -> Unconstrained:
        selected = take_rows(gaussians, np.flatnonzero(chosen))
        rows = -(-int(selected.count * rows_growth) // step) * step
        return with_rows(unconstrain(selected), rows)

    parameters = Parameters(part(~moves), part(moves), None, corrections)
    return begin_state(parameters), replace(progress, limit=limit)


def with_deformation(session: Session, state: State, progress: RunProgress) -> State:
    """The state before the fine stage: tracked rigid bodies, and a deformation field that does
    nothing yet. Without moving Gaussians there is no deformation."""
    parameters, field = state.parameters, session.options.field
    moving = take_rows(parameters.moving, np.flatnonzero(occupied(parameters.moving)))
    if not len(moving.mean):
        return begin_state(parameters)
    begin, end = session.time_range
    # Stray points must not stretch the box: beyond it the field continues its border.
    lower, upper = np.quantile(moving.mean, (0.02, 0.98), axis=0).astype(np.float32)
    margin = 0.1 * (float((upper - lower).max()) or session.extent)
    planes_key, network_key = jax.random.split(jax.random.key(session.options.fit.seed))
    planes = initial_planes(
        planes_key,
        jnp.asarray(lower - margin),
        jnp.asarray(upper + margin),
        (begin - session.cameras.earlier, end + session.cameras.later),
        sides=field.sides,
        instants=field.instants or max(len(session.times), 2),
        channels=field.channels,
    )
    tracked = _tracked(session, constrain(moving), progress)
    deformation = initial_deformation(network_key, planes, tracked, width=field.width)
    return begin_state(
        Parameters(parameters.static, parameters.moving, deformation, parameters.corrections)
    )


def _tracked(session: Session, moving: Gaussians, progress: RunProgress) -> Bodies:
    """The rigid bodies among the moving Gaussians, with their poses at all times.

    There are none where points do not lie on surfaces, nor where every camera took one picture.
    """
    position, times = np.asarray(moving.mean), session.times
    given, start = session.capture.points is not None, session.options.fit.start
    matched = start in ("auto", "stereo") and sum(progress.initial) > 0
    on_surfaces = matched or (given and start != "random")
    trackable = on_surfaces and session.has_videos
    known = progress.bodies
    groups = bodies(
        position if trackable else position[:0],
        times,
        known=None if known is None else (known.pivot, known.radius),
    )
    tracked = track(
        groups,
        MovingGaussians(
            np.asarray(body_of(groups, moving.mean)),
            position,
            np.asarray(rotation_matrix(moving.quat))[:, :, 2],
            np.asarray(moving.harmonics[:, 0] * C0 + 0.5),
        ),
        session.shown,
        session.footage.camera,
        options=session.options.track,
        seed=session.options.fit.seed,
        report=session.progress_bar("track", len(times) - 1).report,
    )
    # Tracking finds a body where it is in the middle of a readout.
    half = (session.cameras.earlier + session.cameras.later) / 2
    middle = tracked.time + jnp.asarray(session.cameras.later - half, tracked.time.dtype)
    return reaching(eqx.tree_at(lambda b: b.time, tracked, middle), half, half)
