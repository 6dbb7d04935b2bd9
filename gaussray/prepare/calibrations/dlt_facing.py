"""Whether the cameras of direct linear transforms (DLT) see upright pictures."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from gaussray.prepare.errors import PrepareError
from gaussray.prepare.pose_math import camera_centre
from gaussray.runtime.progress import say


# Cameras that see one thing come closer as they go forward. These come apart, on average over the
# pairs by at least as much as two whose axes diverge by 10 degrees, for each unit between them.
_APART = 2 * np.sin(np.radians(5))
_UPWARD = (
    "Where rows count from the bottom of the picture, as in Argus and DLTdv before 8, write for L5 "
    "to L8: (rows of the picture - 1) times L9, L10, L11 and 1, minus L5 to L8."
)


def check_dlts(where: object, poses: Sequence[Float[np.ndarray, "3 4"]]) -> None:
    """Print how the coefficients of DLTs are taken; refuse them if they are of mirrored pictures.

    The sign of a DLT is free (`dlt_projection`), so that a mirrored picture shows in no single
    camera: it turns the camera around. But then all cameras that see one thing look away from each
    other. Nothing shows in one camera alone, or in parallel ones: there the matches in the pictures
    tell (`epipolar_findings`).

    Args:
        where: the file or folder.
        poses: world to camera of those cameras that come from a DLT.

    Raises:
        PrepareError: The cameras look away from each other.
    """
    if not len(poses):
        return
    if _closing(poses) < -_APART:
        raise PrepareError(
            f"{where}: the cameras of a DLT must see one thing, got {len(poses)} that look away "
            f"from each other, as mirrored pictures make them do. {_UPWARD} If they do look away, "
            "write 12 numbers of each: L1 to L11 and 1, all negated where that makes the "
            "determinant of the first three columns positive."
        )
    say(f"{where}: the rows of a DLT are taken to count from the top of the picture. {_UPWARD}")


def _closing(poses: Sequence[Float[np.ndarray, "3 4"]]) -> float:
    """How much closer two cameras come, for each unit between them, if both go one forward: on
    average over the pairs, from -2 to 2."""
    found = []
    for one, two in combinations(poses, 2):
        apart = camera_centre(two) - camera_centre(one)
        distance = np.linalg.norm(apart)
        if distance > 0:
            found.append(float(apart @ (one[2, :3] - two[2, :3]) / distance))
    return float(np.mean(found)) if found else 0.0
