"""How many Gaussians may show what moves: no more than the pixels that move can tell apart."""

from typing import NamedTuple

import numpy as np
from jaxtyping import UInt16

from gaussray.reconstruct.session import Session


# Moving pixels for each transient Gaussian, and moving pixels of one time for each Gaussian that
# all times share. Fits of what moves in much of the picture have 6 to 17, and 3 to 4; where a
# person is small, the budget of the whole pictures put two of them on each pixel
# (experiments/captures/log.md).
_PIXELS_TRANSIENT, _PIXELS_SHARED = 4, 1
# The least budget of each kind: a round number, which limits none of the captures in that log.
_FEWEST = 20_000


class MotionBudget(NamedTuple):
    """The largest numbers of Gaussians that follow bodies, control points or a field, and of
    transient ones."""

    moving: int
    transient: int


def motion_budget(
    session: Session, moved: UInt16[np.ndarray, "frames tiles"] | None
) -> MotionBudget:
    """The largest numbers of Gaussians that show what moves, by how many pixels do.

    Where pictures do not tell what moves, the budget of all Gaussians is the only one: with random
    points, a single picture of each viewpoint, or control points that begin at rest, on which all
    Gaussians stand.

    Args:
        session: the segment.
        moved: moving pixels of every frame and tile, where cameras move (`RunProgress.moved`); None
            counts what differs from the temporal medians.
    """
    most = session.options.density.gaussians
    if not session.options.density.relocates or session.at_rest:
        return MotionBudget(most, most)
    if moved is None:
        if session.still_first or not session.has_videos:
            return MotionBudget(most, most)
        # Pictures that are alone at their viewpoint say nothing.
        _, place, taken = np.unique(
            session.footage.viewpoints, return_inverse=True, return_counts=True
        )
        moved = session.activity.moved[taken[place] > 1]
    pixels = float(np.sum(moved, dtype=np.int64)) * len(session.footage.times) / len(moved)
    shared = max(int(pixels / len(session.times) / _PIXELS_SHARED), _FEWEST)
    transient = max(int(pixels / _PIXELS_TRANSIENT), _FEWEST)
    return MotionBudget(min(shared, most), min(transient, most))
