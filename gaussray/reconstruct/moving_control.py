"""Control points before the first step of the fine stage: those that follow surfaces that stereo
finds, and those that begin at rest on the moving Gaussians."""

from collections.abc import Sequence

import jax
import numpy as np

from gaussray.reconstruct.initialize.from_points import inliers
from gaussray.reconstruct.initialize.resting_control import resting_control_points
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.reconstruct.initialize.surface_tracking import tracked_surface
from gaussray.reconstruct.initialize.transients import STRAY
from gaussray.reconstruct.initialize.unexplained import UnexplainedPixels
from gaussray.reconstruct.moving_clouds import by_pictures_alone
from gaussray.reconstruct.optimize.rows import occupied, take_rows
from gaussray.reconstruct.session import Session
from gaussray.scene.control_points import ControlPoints
from gaussray.scene.gaussians import Unconstrained, constrain


# Control points that begin at rest: how many, at most; pictures for each of their poses; and the
# opacity below which a Gaussian is no place for one.
_CONTROL_GPU, _CONTROL_CPU = 400, 200
_PICTURES_OF_A_POSE = 2.5
_FAINT = 0.1


def tracked_control_points(
    session: Session, clouds: Sequence[MovingPoints], moved: UnexplainedPixels | None
) -> ControlPoints | None:
    """Control points that follow the surfaces of the first time; None where there are none.

    Args:
        session: the segment.
        clouds: the points that stereo finds in what moves (`moving_clouds`).
        moved: which pixels what stands still does not show, where cameras move.
    """
    seed = session.options.fit.seed

    def found() -> ControlPoints | None:
        return tracked_surface(clouds, seed=seed, report=session.progress_report("track"))

    if not by_pictures_alone(session, moved):
        return found()
    times = [cloud.time for cloud in clouds]
    return session.shared.once(("control points", *times, *session.points_key), found)


def control_points_at_rest(session: Session, moving: Unconstrained) -> ControlPoints | None:
    """Control points at rest on the moving Gaussians; None without any.

    Each has fewer poses than there are pictures, so that several tell each pose.

    Args:
        session: the segment.
        moving: the moving Gaussians, with spare rows.
    """
    found = constrain(take_rows(moving, np.flatnonzero(occupied(moving))))
    position = np.asarray(found.mean)[np.asarray(found.opacity).reshape(-1) > _FAINT]
    position = position[inliers(position, STRAY)]
    if not len(position):
        return None
    pictures = len(session.footage.times)
    knots = int(np.clip(pictures / _PICTURES_OF_A_POSE, 2, len(session.times)))
    times = np.linspace(session.times[0], session.times[-1], knots)
    count = _CONTROL_GPU if jax.default_backend() == "gpu" else _CONTROL_CPU
    return resting_control_points(position, times, count=count)
