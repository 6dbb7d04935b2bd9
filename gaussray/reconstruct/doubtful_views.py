"""Training pictures that the fitted scene shows much worse than the others."""

import numpy as np
from jaxtyping import Float

from gaussray.reconstruct.session import Session


# A picture is doubtful if its mean error is so many times that of the median picture.
_FAR = 2.5
# Pictures of which fewer are too few to tell what is usual, and names that are listed at most.
_FEWEST, _LISTED = 8, 6


def doubtful_views(session: Session) -> str:
    """A sentence about the training pictures that the fit did not come near; empty if all are
    alike, or where errors are not kept (fit.error).

    Args:
        session: a segment after its last step.
    """
    errors = session.loader.errors
    if errors is None:
        return ""
    _, first = np.unique(session.footage.viewpoints, return_index=True)
    names = session.footage.name[first]
    return doubtful_sentence(names.tolist(), errors.of(first).mean(axis=1))


def doubtful_sentence(names: list[str], error: Float[np.ndarray, " pictures"]) -> str:
    """The sentence about pictures of these names.

    Args:
        names: the pictures' names.
        error: their mean errors, in any unit.
    """
    if len(names) < _FEWEST:
        return ""
    worst = np.argsort(-error, kind="stable")
    worst = worst[error[worst] > _FAR * np.median(error)]
    if not len(worst):
        return ""
    listed = ", ".join(str(names[k]) for k in worst[:_LISTED])
    more = f" and {len(worst) - _LISTED} more" if len(worst) > _LISTED else ""
    return (
        f"{len(worst)} of {len(names)} training pictures stay far from the scene (more than "
        f"{_FAR:g} times the error of the median picture): {listed}{more}. Their poses may be "
        "wrong, or no other picture shows what they do. To fit without one, hold it out: "
        f"capture.test=['{names[worst[0]]}']."
    )
