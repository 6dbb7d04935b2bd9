"""The state before the first step: where the first Gaussians stand, and which of them may move.

A new kind of initialiser is added in `initialize.initializer.initial_points`.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from gaussray.camera.corrections import Corrections, no_corrections
from gaussray.capture.errors import CaptureWarning
from gaussray.geometry import rotation_matrix
from gaussray.reconstruct.data.motion_mask import point_activity
from gaussray.reconstruct.initialize.body_tracking import MovingGaussians, track
from gaussray.reconstruct.initialize.from_points import bodies, on_points, surrounding, thinned
from gaussray.reconstruct.initialize.stereo.from_pictures import (
    MovingPoints,
    first_views,
    moving_points,
)
from gaussray.reconstruct.initialize.stereo.uncovered import VIEWS, hiding
from gaussray.reconstruct.initialize.surface_tracking import tracked_surface
from gaussray.reconstruct.initialize.transients import initial_transients, starting_times
from gaussray.reconstruct.initialize.unexplained import UnexplainedPixels
from gaussray.reconstruct.optimize.optimizer import Parameters, shortest_lifetime
from gaussray.reconstruct.optimize.rows import occupied, take_rows, with_rows
from gaussray.reconstruct.optimize.state import State, begin_state
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.session import Session
from gaussray.runtime.devices import agreed
from gaussray.runtime.progress import Progress
from gaussray.scene.bodies import Bodies, Poses, body_of, extrapolate_bodies
from gaussray.scene.control_points import ControlPoints
from gaussray.scene.deformation import Deformation, initial_deformation
from gaussray.scene.gaussians import Gaussians, Unconstrained, constrain, unconstrain
from gaussray.scene.harmonics import C0
from gaussray.scene.planes import initial_planes
from gaussray.scene.transient import UnconstrainedTransients, unconstrain_transients


def initial_state(session: Session, progress: RunProgress) -> tuple[State, RunProgress]:
    """The state before the coarse stage, and the progress with the numbers of Gaussians.

    Gaussians stand on the points of an initialiser and on random ones around these. Which of them
    may move is decided here, so that static and moving Gaussians keep their rows.

    Args:
        session: the first segment.
        progress: the progress so far.
    """
    fit, (position, color, on_surfaces) = session.options.fit, session.initial_points
    moves = _moves(session, position, on_surfaces=on_surfaces)
    if not fit.deforms:
        # What moves gets transient Gaussians (`with_motion`).
        position, color, moves = position[~moves], color[~moves], moves[~moves]
    if session.options.density.relocates:
        share = 0.5 if fit.transient else 1.0
        room = int(share * session.options.density.gaussians / (1 + on_surfaces * fit.surround))
        chosen = thinned(len(position), count=max(room, 1), seed=fit.seed)
        position, color, moves = position[chosen], color[chosen], moves[chosen]
    gaussians = on_points(
        position, color, degree=fit.degree, opacity=fit.opacity, spread=fit.spread
    )
    initial = _counts(moves) if on_surfaces else (0, 0)
    count = round(fit.surround * len(position)) if on_surfaces else 0
    if count:
        around = surrounding(position, count=count, seed=fit.seed)
        more = on_points(*around, degree=fit.degree, opacity=0.5, flat=1.0)
        gaussians, more = jax.device_get((gaussians, more))
        # Cameras that stand outside the points look through one of the boxes around these.
        views = first_views(session.footage, VIEWS)
        hides = hiding(views, position, more.mean, more.scale[:, 0], count=fit.points)
        more = take_rows(more, np.flatnonzero(~hides))
        gaussians = jax.tree.map(lambda a, b: np.concatenate([a, b]), gaussians, more)
        moves = np.concatenate([moves, np.zeros(more.count, bool)])
    most = session.options.density.room(len(moves))
    progress = replace(progress, initial=initial, most=most)
    corrections = no_corrections(fit.refine, len(session.names), session.footage.camera)
    return _with_room(session, gaussians, moves, corrections, progress)


def continued_state(
    session: Session, state: State, progress: RunProgress
) -> tuple[State, RunProgress]:
    """The state before the fine stage of a later segment, from what the one before handed over.

    The Gaussians whose pixels change in this segment may move now.

    Args:
        session: the later segment.
        state: the state that was handed over (`session.hand_over`), with static Gaussians only.
        progress: the progress that was handed over.
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
    """Which Gaussians may move. Of random points, and without cameras that stand still, pictures do
    not tell: then all may, or none if only transient Gaussians move."""
    told, deforms = on_surfaces and session.has_videos, session.options.fit.deforms
    if len(session.times) == 1 or not (deforms or (told and not session.later)):
        return np.zeros(len(position), bool)
    changing = point_activity(session.footage, position) > session.options.fit.moving
    moves = np.array(agreed(changing))
    if not told:
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


def with_motion(session: Session, state: State, progress: RunProgress) -> tuple[State, RunProgress]:
    """The state before the fine stage, with all that shows what moves (fit.motion): tracked rigid
    bodies, a deformation field that does nothing yet, and transient Gaussians.

    Args:
        session: the segment.
        state: the state after the coarse stage, or before the first step of a later segment.
        progress: the progress so far, with the rigid bodies of the segment before.

    Returns:
        The state, and the progress, which has no plan of steps yet.
    """
    parameters, progress = state.parameters, replace(progress, planned=0)
    deformation, transient = parameters.deformation, parameters.transient
    clouds, control, moved, fit = [], None, None, session.options.fit
    if fit.transient:
        moved = _unexplained(session, state) if session.still_first else None
        clouds = _clouds(session, parameters, moved)
    if fit.control and session.has_videos:
        control = tracked_surface(clouds, seed=fit.seed, report=_reporter(session, "track"))
        control = agreed(control)
    if fit.deforms:
        deformation = _deformation(session, parameters, progress, control)
    if fit.transient:
        transient = _transients(session, clouds, moved)
    if moved is not None:
        progress = replace(progress, moved=moved.tile_counts())
        session.loader.sampler.see_moved(moved.tile_counts())
    static, moving, corrections = parameters.static, parameters.moving, parameters.corrections
    return begin_state(Parameters(static, moving, deformation, corrections, transient)), progress


def _unexplained(session: Session, state: State) -> UnexplainedPixels:
    """Which pixels of a training frame the static Gaussians of a state do not show."""
    static = state.parameters.static
    return UnexplainedPixels(
        session.footage,
        *session.training_cameras(state),
        constrain(take_rows(static, np.flatnonzero(occupied(static)))),
        session.options.trace,
    )


def _reporter(session: Session, what: str) -> Callable[[int, int], None]:
    """A function that shows the progress of a piece of work, whose total it learns when called."""
    bar: list[Progress] = []

    def report(done: int, total: int) -> None:
        if not bar:
            bar.append(session.progress_bar(what, total))
        bar[0].report(done)

    return report


def _clouds(
    session: Session, parameters: Parameters, moved: UnexplainedPixels | None
) -> Sequence[MovingPoints]:
    """The points that stereo finds in what moves at each time."""
    held = occupied(parameters.static)
    return moving_points(
        session.footage,
        starting_times(session.times, session.options.fit.instants).tolist(),
        moved=moved,
        known=np.asarray(parameters.static.mean)[held],
        report=_reporter(session, "stereo of what moves"),
    )


def _transients(
    session: Session, clouds: Sequence[MovingPoints], moved: UnexplainedPixels | None
) -> UnconstrainedTransients | None:
    """Transient Gaussians on the points that stereo finds in what moves, with rows for those that
    density control may add; None where it finds nothing."""
    fit, density = session.options.fit, session.options.density
    first = initial_transients(
        clouds,
        starting_times(session.times, fit.instants),
        count=density.gaussians // 2,
        degree=fit.degree,
        seed=fit.seed,
    )
    if not first.count:
        if moved is not None and not moved.tile_counts().any():
            return None
        warnings.warn(
            "stereo finds no points in what moves, so there are no transient Gaussians, and "
            "nothing moves. If something does: they need at least two pictures of every time; "
            "fit.motion=deformation does not.",
            CaptureWarning,
            stacklevel=2,
        )
        return None
    rows = density.gaussians if density.relocates else first.count
    step = 8 * session.mesh.size
    shortest = shortest_lifetime(session.cameras.times, first.instant)
    return with_rows(unconstrain_transients(first, shortest), -(-rows // step) * step)


def _deformation(
    session: Session, parameters: Parameters, progress: RunProgress, control: ControlPoints | None
) -> Deformation | None:
    """Control points or tracked rigid bodies, and a field that does nothing yet; None without
    moving Gaussians."""
    field = session.options.field
    moving = take_rows(parameters.moving, np.flatnonzero(occupied(parameters.moving)))
    if not len(moving.mean):
        return None
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
    if session.options.fit.control:
        nothing = np.zeros((0, 3), np.float32)
        tracked = bodies(nothing, session.times)
        control = None if control is None else _over_readouts(session, control)
    else:
        tracked = _over_readouts(session, _tracked(session, constrain(moving), progress))
    return initial_deformation(network_key, planes, tracked, width=field.width, control=control)


def _over_readouts(session: Session, tracked: Poses) -> Poses:
    """Bodies or control points with poses for the whole of the first and the last readout."""
    # Tracking finds a body where it is in the middle of a readout.
    half = (session.cameras.earlier + session.cameras.later) / 2
    middle = tracked.time + jnp.asarray(session.cameras.later - half, tracked.time.dtype)
    return extrapolate_bodies(eqx.tree_at(lambda b: b.time, tracked, middle), half, half)


def _tracked(session: Session, moving: Gaussians, progress: RunProgress) -> Bodies:
    """The rigid bodies among what moves, with their poses at all times.

    There are none where points do not lie on surfaces, nor where every camera took one picture.
    """
    times, known = session.times, progress.bodies
    given, start = session.capture.points is not None, session.options.fit.start
    matched = start in ("auto", "stereo") and sum(progress.initial) > 0
    on_surfaces = matched or (given and start != "random")
    if on_surfaces and session.has_videos:
        surface = moving if session.later else _initial_surface(session)
    else:
        surface = take_rows(moving, np.zeros(0, int))
    position = np.asarray(surface.mean)
    groups = bodies(position, times, known=None if known is None else (known.pivot, known.radius))
    return track(
        groups,
        MovingGaussians(
            np.asarray(body_of(groups, surface.mean)),
            position,
            np.asarray(rotation_matrix(surface.quat))[:, :, 2],
            np.asarray(surface.harmonics[:, 0] * C0 + 0.5),
        ),
        session.shown,
        session.footage.camera,
        options=session.options.track,
        seed=session.options.fit.seed,
        report=session.progress_bar("track", len(times) - 1).report,
    )


def _initial_surface(session: Session) -> Gaussians:
    """Discs on the initial points that move. They have the colours of the surface; those of fitted
    Gaussians, which overlap, make up for one another."""
    position, color, on_surfaces = session.initial_points
    moves = _moves(session, position, on_surfaces=on_surfaces)
    return on_points(position[moves], color[moves], degree=0, opacity=1.0)
