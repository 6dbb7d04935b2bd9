"""The state before the first step: where the first Gaussians stand, and which of them may move.

A new kind of initialiser is added in `initialize.initializer.initial_points`.
"""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Bool, Float

from gaussray.camera.corrections import Corrections, no_corrections
from gaussray.reconstruct.data.motion_mask import point_activity
from gaussray.reconstruct.initialize.from_points import on_points, surrounding, thinned
from gaussray.reconstruct.initialize.stereo.uncovered import VIEWS, hiding
from gaussray.reconstruct.initialize.stereo.view_sets import first_views
from gaussray.reconstruct.motion_budget import motion_budget
from gaussray.reconstruct.optimize.free_space import FreeBalls, free_balls
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.rows import occupied, take_rows, with_rows
from gaussray.reconstruct.optimize.state import State, begin_state
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.session import Session
from gaussray.runtime.devices import from_primary
from gaussray.scene.gaussians import Gaussians, Unconstrained, constrain, unconstrain


# Where transient Gaussians share the budget: rows for each Gaussian of another kind, and the least
# share of the budget for which a GPU has rows of what stands still and of what moves.
_ROWS_EACH, _ROWS_STILL, _ROWS_MOVING = 2, 1.0, 0.25


def initial_state(session: Session, progress: RunProgress) -> tuple[State, RunProgress]:
    """The state before the coarse stage, and the progress with the numbers of Gaussians.

    Gaussians stand on the points of an initialiser and on random ones around these. Which of them
    may move is decided here, so that static and moving Gaussians keep their rows.

    Args:
        session: the first segment.
        progress: the progress so far.
    """
    fit, (position, color, on_surfaces) = session.options.fit, session.initial_points
    moves = may_move(session, position, on_surfaces=on_surfaces)
    space = _free_space(session, position) if on_surfaces else None
    outside = session.outside(position)
    # Masks that leave none are wrong.
    if not outside.all():
        position, color, moves = position[~outside], color[~outside], moves[~outside]
    if session.still_first or not fit.deforms:
        # What moves gets its Gaussians later (`motion.with_motion`).
        position, color, moves = position[~moves], color[~moves], moves[~moves]
    if session.options.density.relocates:
        share = 0.5 if fit.transient else 1.0
        room = int(share * session.options.density.gaussians / (1 + on_surfaces * fit.surround))
        chosen = thinned(len(position), count=max(room, 1), seed=fit.seed)
        position, color, moves = position[chosen], color[chosen], moves[chosen]
    gaussians = on_points(
        position, color, degree=fit.degree, opacity=fit.initial_opacity, spread=fit.initial_scale
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
        more = take_rows(more, np.flatnonzero(~hides & ~session.outside(more.mean)))
        gaussians = jax.tree.map(lambda a, b: np.concatenate([a, b]), gaussians, more)
        moves = np.concatenate([moves, np.zeros(more.count, bool)])
    most = session.options.density.room(len(moves))
    progress = replace(progress, initial=initial, most=most, free_space=space)
    corrections = no_corrections(fit.refine, len(session.names), session.footage.camera)
    return _with_room(session, gaussians, moves, corrections, progress)


def _free_space(session: Session, position: Float[np.ndarray, "points 3"]) -> FreeBalls | None:
    """Where nothing is, before points on what the pictures show."""
    eye = np.asarray(session.footage.camera.trajectory.translation).reshape(-1, 3)
    return free_balls(eye, position, session.options.density.free_space)


def continued_state(
    session: Session, state: State, progress: RunProgress
) -> tuple[State, RunProgress]:
    """The state before the fine stage of a later segment, from what the one before handed over.

    The Gaussians whose pixels change in this segment may move now.

    Args:
        session: the later segment.
        state: the state that was handed over (`hand_over`), with static Gaussians only.
        progress: the progress that was handed over.
    """
    static = state.parameters.static
    gaussians = constrain(take_rows(static, np.flatnonzero(occupied(static))))
    moves = may_move(session, np.asarray(gaussians.mean), on_surfaces=True)
    progress = replace(progress, initial=_counts(moves))
    return _with_room(session, gaussians, moves, state.parameters.corrections, progress)


def _counts(moves: Bool[np.ndarray, " gaussians"]) -> tuple[int, int]:
    """How many are static, and how many move."""
    return int((~moves).sum()), int(moves.sum())


def may_move(
    session: Session, position: Float[np.ndarray, "points 3"], *, on_surfaces: bool
) -> Bool[np.ndarray, " points"]:
    """Which Gaussians may move. Of random points, and without cameras that stand still, pictures do
    not tell, and with few pictures from each place (control points that begin at rest) they say
    little: then all may, or none if what moves gets its Gaussians later.

    Args:
        session: the segment.
        position: places of the Gaussians.
        on_surfaces: whether they lie on surfaces.
    """
    measured = on_surfaces and session.has_videos and not session.at_rest
    deforms = session.options.fit.deforms and not session.still_first
    if len(session.times) == 1 or not (deforms or (measured and not session.is_continuation)):
        return np.zeros(len(position), bool)
    changing = point_activity(session.footage, position) > session.options.fit.moving_threshold
    moves = np.array(from_primary(changing))
    if not measured:
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
    density, (still, moving) = session.options.density, _least_shares()
    # A multiple of 8 on every device.
    step, most_moving = 8 * session.mesh.size, motion_budget(session, None).moving

    def part(
        chosen: Bool[np.ndarray, " gaussians"], share: float, most: int = progress.most
    ) -> Unconstrained:
        selected = take_rows(gaussians, np.flatnonzero(chosen))
        rows = int(selected.count * growth) if density.interval else selected.count
        if density.relocates and session.options.fit.transient:
            rows = rows_beside_transients(selected.count, progress.most, share=share)
        if density.relocates:
            rows = min(rows, max(most, selected.count))
        return with_rows(unconstrain(selected), -(-rows // step) * step)

    parameters = Parameters(
        part(~moves, still), part(moves, moving, most_moving), None, corrections
    )
    return begin_state(parameters), replace(progress, limit=limit)


def _least_shares() -> tuple[float, float]:
    """The least share of the budget for which this device has rows of what stands still and of what
    moves, where transient Gaussians share the budget."""
    return (_ROWS_STILL, _ROWS_MOVING) if jax.default_backend() == "gpu" else (0.0, 0.0)


def rows_beside_transients(count: int, budget: int, *, share: float) -> int:
    """How many rows static or moving Gaussians begin with where transient ones share the budget.

    Every step computes empty rows, too, so they begin with two rows each. Where these fill up, more
    are added (`relocate_dead`), and programs compile again. A GPU waits longer for that than its
    steps take for rows that stay empty. What stands still comes to most of the budget, what moves
    seldom exceeds a quarter (experiments/captures/log.md).

    Args:
        count: number of Gaussians of the kind.
        budget: the largest number of Gaussians of all kinds, at least `count`.
        share: least share of the budget for which there are rows, if there are Gaussians.
    """
    least = int(share * budget) if count else 0
    return min(budget, max(least, _ROWS_EACH * count))
