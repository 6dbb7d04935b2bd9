"""Whether and on which points a fit measures the shadows that pass over what stands still."""

import numpy as np
from jaxtyping import Float

from gaussray.reconstruct.initialize.from_points import thinned
from gaussray.reconstruct.initialize.shadows import measured_shading
from gaussray.reconstruct.optimize.rows import occupied
from gaussray.reconstruct.session import Session
from gaussray.scene.gaussians import Unconstrained
from gaussray.scene.shading import Shading


# Points on which shadows are measured, at most.
_MOST = 20_000
# Share of the static Gaussians of the segment before that, on each side of each axis, may stand
# around the room (`from_points.surrounding`), and the margin about all others.
_AROUND, _MARGIN = 0.03, 0.1


def passing_shadows(session: Session, static: Unconstrained) -> Shading | None:
    """Shadows that pass over what stands still; None where too few cameras stand still, and with
    transient Gaussians, which show them as well (experiments/captures/log.md).

    They are measured on the starting points, or in a later segment on the static Gaussians.

    Args:
        session: the segment.
        static: the static Gaussians.
    """
    fit = session.options.fit
    motion_is_measured = (
        fit.deforms and not fit.transient and session.has_videos and not session.at_rest
    )
    if not (fit.shading and motion_is_measured) or len(session.times) < 2:
        return None

    def found(position: Float[np.ndarray, "points 3"]) -> Shading | None:
        chosen = thinned(len(position), count=_MOST, seed=fit.seed)
        report = session.progress_report("shadows", patience=2.0)
        return measured_shading(session.footage, position[chosen], report=report)

    if session.is_continuation:
        return found(_in_the_room(np.asarray(static.mean)[occupied(static)]))
    points = session.initial_points
    if not points.on_surfaces:
        return None
    return session.shared.once(("shading", *session.points_key), lambda: found(points.position))


def _in_the_room(position: Float[np.ndarray, "places 3"]) -> Float[np.ndarray, "inner 3"]:
    """The places without those that stand around the others."""
    if not len(position):
        return position
    lower, upper = np.quantile(position, (_AROUND, 1 - _AROUND), axis=0)
    margin = _MARGIN * (upper - lower)
    return position[np.all((position >= lower - margin) & (position <= upper + margin), axis=1)]
