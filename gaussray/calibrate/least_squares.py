"""Robust least squares: Levenberg-Marquardt steps, covariances, correlated unknowns."""

import numpy as np
from jaxtyping import Float


# Standard deviation of normal errors over their median size.
_MEDIAN = 1.4826
# Least eigenvalue of a curvature with a unit diagonal.
_LEAST = 1e-7


def robust_deviation(residual: Float[np.ndarray, " n"], least: float = 0.0) -> float:
    """Standard deviation of residuals with outliers, from their median absolute value.

    Args:
        residual: the residuals.
        least: smallest value to return.
    """
    return max(_MEDIAN * float(np.median(np.abs(residual))), least)


def huber(residual: Float[np.ndarray, "..."], bend: float) -> float:
    """Sum of Huber's losses: r^2 / 2 up to the bend, bend |r| - bend^2 / 2 beyond.

    Args:
        residual: the residuals r.
        bend: where the loss turns linear.
    """
    size = np.abs(residual.astype(np.float64))
    return float(np.sum(np.where(size < bend, size**2 / 2, bend * size - bend**2 / 2)))


def marquardt_step(
    curvature: Float[np.ndarray, "n n"], gradient: Float[np.ndarray, " n"], damping: float
) -> Float[np.ndarray, " n"]:
    """A Levenberg-Marquardt step (Marquardt 1963): -(H + damping diag H)^-1 g.

    Unknowns without effect on the residuals do not change.

    Args:
        curvature: H, the Gauss-Newton Hessian.
        gradient: g.
        damping: damping of the step.
    """
    size = _sizes(curvature)
    return (
        -np.linalg.solve(_unit_diagonal(curvature) + damping * np.eye(len(size)), gradient / size)
        / size
    )


def covariance(
    curvature: Float[np.ndarray, "n n"], scatter: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "n n"]:
    """Covariance of the unknowns, H^-1 M H^-1 (Huber 1967).

    For independent errors of one size it is sigma^2 (J^T J)^-1.

    Args:
        curvature: H, the Gauss-Newton Hessian.
        scatter: M, the sum of g g^T over parts with independent errors, g their gradients.
    """
    inverse, size = _inverse(curvature), _sizes(curvature)
    # What the curvature cannot tell from nothing, the scatter cannot either.
    unit = scatter / np.outer(size, size)
    least = _LEAST * np.mean(np.diag(unit)) * np.diag(size**2)
    return inverse @ (scatter + least) @ inverse


def correlated_pairs(
    curvature: Float[np.ndarray, "n n"], least: float
) -> list[tuple[int, int, float]]:
    """Pairs of unknowns with correlated errors: the others can nearly compensate a change of one.

    Args:
        curvature: the Gauss-Newton Hessian.
        least: smallest absolute correlation.

    Returns:
        Indices and correlation of each pair, the largest first.
    """
    inverse = _inverse(curvature)
    size = np.sqrt(np.diag(inverse))
    correlation = np.triu(inverse / np.outer(size, size), 1)
    pairs = zip(*np.nonzero(np.abs(correlation) >= least), strict=True)
    correlated = [(int(i), int(j), float(correlation[i, j])) for i, j in pairs]
    return sorted(correlated, key=lambda pair: -abs(pair[2]))


def _inverse(curvature):
    """Of a matrix whose entries are known to single precision: nothing is better determined."""
    size = _sizes(curvature)
    value, vector = np.linalg.eigh(_unit_diagonal(curvature))
    inverse = (vector / np.maximum(value, _LEAST)) @ vector.T
    return inverse / np.outer(size, size)


def _sizes(curvature):
    size = np.sqrt(np.diag(curvature))
    return np.where(size > 0, size, 1)


def _unit_diagonal(curvature):
    size = _sizes(curvature)
    unit = curvature / np.outer(size, size)
    np.fill_diagonal(unit, 1)
    return unit
