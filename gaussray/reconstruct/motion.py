"""What shows what moves, before the first step of the fine stage: control points or tracked rigid
bodies, a deformation field, and transient Gaussians (fit.motion); and the shadows that pass."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt16

from gaussray.capture.errors import CaptureWarning
from gaussray.reconstruct.initialize.body_groups import body_groups
from gaussray.reconstruct.initialize.from_points import inliers, on_points, thinned
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.reconstruct.initialize.transients import STRAY, initial_transients, starting_times
from gaussray.reconstruct.initialize.unexplained import UnexplainedPixels
from gaussray.reconstruct.motion_budget import motion_budget
from gaussray.reconstruct.moving_bodies import tracked_bodies
from gaussray.reconstruct.moving_clouds import moving_clouds
from gaussray.reconstruct.moving_control import control_points_at_rest, tracked_control_points
from gaussray.reconstruct.optimize.optimizer import Parameters, shortest_lifetime
from gaussray.reconstruct.optimize.rows import occupied, take_rows, with_rows
from gaussray.reconstruct.optimize.state import State, begin_state
from gaussray.reconstruct.passing_shadows import passing_shadows
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.session import Session
from gaussray.runtime.devices import from_primary
from gaussray.scene.bodies import Poses, extrapolate_bodies
from gaussray.scene.control_points import ControlPoints
from gaussray.scene.deformation import Deformation, initial_deformation
from gaussray.scene.gaussians import constrain, unconstrain
from gaussray.scene.planes import initial_planes
from gaussray.scene.transient import UnconstrainedTransients, unconstrain_transients


# Of all Gaussians, at most one in so many begins as one that follows control points, where cameras
# move.
_FOLLOWERS = 4


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
    parameters, progress = state.parameters, replace(progress, planned=None)
    deformation, transient = parameters.deformation, parameters.transient
    clouds, control, moved, fit = [], None, None, session.options.fit
    if fit.transient:
        moved = _unexplained(session, state) if session.still_first else None
        clouds = moving_clouds(session, parameters, moved)
    if session.at_rest:
        control = from_primary(control_points_at_rest(session, parameters.moving))
    if fit.control and (session.has_videos or session.still_first):
        control = from_primary(tracked_control_points(session, clouds, moved))
    if moved is not None:
        # Of all the frames that were asked for.
        counts = moved.tile_counts()
        progress = replace(progress, moved=counts)
        session.loader.sampler.see_moved(counts)
    if control is not None and session.still_first:
        parameters, progress = _with_followers(session, parameters, clouds[0], progress)
    if fit.deforms:
        deformation = first_deformation(session, parameters, progress, control)
    if fit.transient:
        transient = first_transients(session, clouds, progress.moved)
    shading = from_primary(passing_shadows(session, parameters.static))
    parameters = replace(parameters, deformation=deformation, transient=transient, shading=shading)
    return begin_state(parameters), progress


def find_motion(session: Session, parameters: Parameters) -> None:
    """Find what pictures alone tell of what moves (`by_pictures_alone`): its points and control
    points, which fits of the same pictures share.

    Args:
        session: the segment.
        parameters: the Gaussians, of any values.
    """
    clouds = moving_clouds(session, parameters, None)
    if session.options.fit.control and session.has_videos:
        tracked_control_points(session, clouds, None)


def _unexplained(session: Session, state: State) -> UnexplainedPixels:
    """Which pixels of a training frame the static Gaussians of a state do not show."""
    static = state.parameters.static
    return UnexplainedPixels(
        session.footage,
        *session.training_cameras(state),
        constrain(take_rows(static, np.flatnonzero(occupied(static)))),
        session.options.trace,
        session.backdrop,
    )


def _with_followers(
    session: Session, parameters: Parameters, cloud: MovingPoints, progress: RunProgress
) -> tuple[Parameters, RunProgress]:
    """The parameters with Gaussians on the moving points of the first time, which will follow
    control points; with rows for those that density control may add."""
    fit, density, found = session.options.fit, session.options.density, cloud.points
    near = np.flatnonzero(inliers(found.position, STRAY))
    budget = motion_budget(session, progress.moved).moving
    first = min(density.gaussians // _FOLLOWERS, budget)
    chosen = near[thinned(len(near), count=first, seed=fit.seed)]
    gaussians = on_points(
        found.position[chosen],
        found.light[chosen],
        degree=fit.degree,
        opacity=fit.initial_opacity,
        spread=fit.initial_scale,
    )
    rows = min(2 * len(chosen), budget) if density.relocates else len(chosen)
    step = 8 * session.mesh.size
    moving = with_rows(unconstrain(gaussians), -(-rows // step) * step)
    progress = replace(progress, initial=(progress.initial[0], len(chosen)))
    return eqx.tree_at(lambda p: p.moving, parameters, moving), progress


def first_transients(
    session: Session,
    clouds: Sequence[MovingPoints],
    moved: UInt16[np.ndarray, "frames tiles"] | None,
) -> UnconstrainedTransients | None:
    """Transient Gaussians on the points that stereo finds in what moves, with rows for those that
    density control may add; None where it finds nothing.

    Args:
        session: the segment.
        clouds: the points of each of the `starting_times`.
        moved: moving pixels of every frame and tile, where cameras move (`RunProgress.moved`).
    """
    fit, density = session.options.fit, session.options.density
    most = motion_budget(session, moved).transient
    first = initial_transients(
        clouds,
        starting_times(session.times, fit.instants),
        count=most // 2,
        degree=fit.degree,
        seed=fit.seed,
    )
    if not first.count:
        if moved is not None and not moved.any():
            return None
        warnings.warn(
            "Stereo finds no points on moving things, so the scene will be static. If something "
            "moves, set fit.motion=deformation, or from_rest if most times have a single picture: "
            "these begin without such points.",
            CaptureWarning,
            stacklevel=2,
        )
        return None
    rows = most if density.relocates else first.count
    step = 8 * session.mesh.size
    shortest = shortest_lifetime(session.cameras.times, first.instant)
    return with_rows(unconstrain_transients(first, shortest), -(-rows // step) * step)


def first_deformation(
    session: Session, parameters: Parameters, progress: RunProgress, control: ControlPoints | None
) -> Deformation | None:
    """Control points or tracked rigid bodies, and a field that does nothing yet; None without
    moving Gaussians.

    Args:
        session: the segment.
        parameters: the Gaussians.
        progress: the progress so far, with the rigid bodies of the segment before.
        control: the control points, where these show motion.
    """
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
    if session.options.fit.control or session.at_rest:
        nothing = np.zeros((0, 3), np.float32)
        tracked = body_groups(nothing, session.times)
        control = None if control is None else _over_readouts(session, control)
    else:
        tracked = _over_readouts(session, tracked_bodies(session, constrain(moving), progress))
    return initial_deformation(network_key, planes, tracked, width=field.width, control=control)


def _over_readouts(session: Session, tracked: Poses) -> Poses:
    """Bodies or control points with poses for the whole of the first and the last readout."""
    # Tracking finds a body where it is in the middle of a readout.
    half = (session.cameras.earlier + session.cameras.later) / 2
    middle = tracked.time + jnp.asarray(session.cameras.later - half, tracked.time.dtype)
    return extrapolate_bodies(eqx.tree_at(lambda b: b.time, tracked, middle), half, half)
