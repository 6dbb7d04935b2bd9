"""Training pictures that the fitted scene shows much worse than the others."""

import numpy as np
from jaxtyping import Float

from gaussray.runtime.output import listed_names


# A picture is doubtful if its mean error is so many times that of the median picture; of a picture
# of which less than this share of the tiles was drawn, nothing is known.
_FAR, _SEEN = 2.5, 0.5
# Pictures of which fewer are too few to tell what is usual, and names that are listed at most.
_FEWEST, _LISTED = 8, 6


def doubtful_views(names: list[str], error: Float[np.ndarray, "pictures tiles"]) -> str:
    """A sentence about the pictures that a fit did not come near; empty if all are alike.

    Args:
        names: the pictures' names.
        error: errors of their tiles after the fit, in any unit; NaN of those that were never drawn
            (masked or held-out ones).
    """
    judged = np.flatnonzero(np.mean(~np.isnan(error), axis=1) >= _SEEN)
    if len(judged) < _FEWEST:
        return ""
    mean = np.nanmean(error[judged], axis=1)
    worst = np.argsort(-mean, kind="stable")
    far = [names[judged[k]] for k in worst if mean[k] > _FAR * np.median(mean)]
    if not far:
        return ""
    among = f"{len(judged)} training pictures"
    if len(judged) < len(names):
        among = f"the {len(judged)} training pictures that were compared"
    return (
        f"{len(far)} of {among} stay far from the scene (more than "
        f"{_FAR:g} times the error of the median picture): {listed_names(far, most=_LISTED)}. "
        "Their poses may be wrong, or no other picture shows what they do. To fit without one, "
        f"hold it out: capture.test=['{far[0]}']."
    )
