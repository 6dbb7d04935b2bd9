"""Clouds of points that stereo finds in what moves, at the times at which transient Gaussians
start."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints, moving_points
from gaussray.reconstruct.initialize.transients import starting_times
from gaussray.reconstruct.initialize.unexplained import UnexplainedPixels
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.rows import occupied
from gaussray.reconstruct.session import Session


def moving_clouds(
    session: Session, parameters: Parameters, moved: UnexplainedPixels | None
) -> Sequence[MovingPoints]:
    """The points that stereo finds in what moves at each time.

    Args:
        session: the segment.
        parameters: the Gaussians; the static ones tell what stands still, unless pictures do.
        moved: which pixels what stands still does not show, where cameras move.
    """
    times = starting_times(session.times, session.options.fit.instants).tolist()

    def found(known: Float[np.ndarray, "known 3"]) -> Sequence[MovingPoints]:
        report = session.progress_report("stereo of what moves")
        alone = None if moved is None else moved.points
        return moving_points(
            session.footage, times, moved=moved, known=known, alone=alone, report=report
        )

    if not by_pictures_alone(session, moved):
        held = occupied(parameters.static)
        return found(np.asarray(parameters.static.mean)[held])
    points, key = session.initial_points, ("moving points", *times, *session.points_key)
    return session.shared.once(key, lambda: found(points.position))


def by_pictures_alone(session: Session, moved: UnexplainedPixels | None) -> bool:
    """Whether the pictures tell what moves, and where what stands still is, before any fit.

    Args:
        session: the segment.
        moved: which pixels what stands still does not show, where cameras move.
    """
    return moved is None and not session.is_continuation and session.initial_points.on_surfaces
