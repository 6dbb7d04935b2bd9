"""Robust least squares: a step, the errors of what is found, and what is confounded."""

import numpy as np
from jaxtyping import Float


# Standard deviation of normal errors over their median size.
_MEDIAN = 1.4826


def spread(residual: Float[np.ndarray, " n"], least: float = 0.0) -> float:
    """Standard deviation of errors of which some are outliers, from their median size."""
    return max(_MEDIAN * float(np.median(np.abs(residual))), least)


def huber(residual: Float[np.ndarray, "..."], bend: float) -> float:
    """Sum of Huber's losses: r^2 / 2 up to the bend, bend |r| - bend^2 / 2 beyond."""
    size = np.abs(residual.astype(np.float64))
    return float(np.sum(np.where(size < bend, size**2 / 2, bend * size - bend**2 / 2)))


def step(
    curvature: Float[np.ndarray, "n n"], gradient: Float[np.ndarray, " n"], damping: float
) -> Float[np.ndarray, " n"]:
    """Levenberg and Marquardt's step (Marquardt 1963): -(H + damping diag H)^-1 g. What no picture
    tells stays as it is."""
    size = _sizes(curvature)
    return (
        -np.linalg.solve(_unit_diagonal(curvature) + damping * np.eye(len(size)), gradient / size)
        / size
    )


def covariance(
    curvature: Float[np.ndarray, "n n"], scatter: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "n n"]:
    """H^-1 M H^-1 (Huber 1967): `scatter` M is the sum of g g^T over what errs independently, g its
    share of the gradient. For independent errors of one size, sigma^2 (J^T J)^-1."""
    size = _sizes(curvature)
    inverse = np.linalg.pinv(_unit_diagonal(curvature), rcond=1e-10, hermitian=True)
    inverse = inverse / np.outer(size, size)
    return inverse @ scatter @ inverse


def confounded(curvature: Float[np.ndarray, "n n"], least: float) -> list[tuple[list[int], float]]:
    """Which numbers undo each other, and how well: what is left of the change that each makes
    alone, if they go together, where that is below `least`.

    Eigenvectors of H with a unit diagonal, and the roots of their eigenvalues: sqrt(1 - |r|) for
    two numbers whose columns correlate by r.
    """
    value, vector = np.linalg.eigh(_unit_diagonal(curvature))
    left = np.sqrt(np.maximum(value, 0))
    return [
        ([int(i) for i in np.flatnonzero(np.abs(vector[:, k]) > 0.3)], float(left[k]))
        for k in np.flatnonzero(left < least)
    ]


def _sizes(curvature):
    size = np.sqrt(np.diag(curvature))
    return np.where(size > 0, size, 1)


def _unit_diagonal(curvature):
    size = _sizes(curvature)
    unit = curvature / np.outer(size, size)
    np.fill_diagonal(unit, 1)
    return unit
