"""Checks of the numbers that calibrations around OpenCV hold under a key."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float


# OpenCV's numbers of distortion coefficients.
DISTORTION_COUNTS = (4, 5, 8, 12, 14)
# A rotation times its transpose may differ from the identity by this, where text has few digits.
ORTHONORMAL = 1e-3


def finite_numbers(value: Any, counts: Sequence[int]) -> Float[np.ndarray, " n"]:
    """The numbers of a value of any shape, in reading order.

    Args:
        value: an array, a list or a number.
        counts: how many there may be.

    Raises:
        ValueError: There are others than these, or some are not finite. The message is to stand
            after the key: "must be 9 finite numbers, got 6".
    """
    wanted = f"must be {' or '.join(map(str, counts))} finite numbers"
    if isinstance(value, np.ndarray) and value.dtype.kind not in "fiu":
        raise ValueError(f"{wanted}, got values of type {value.dtype}")
    try:
        numbers = np.array(value, np.float64).ravel()
    except (ValueError, TypeError, OverflowError):
        raise ValueError(f"{wanted}, got {str(value)[:80]}") from None
    if len(numbers) not in counts:
        raise ValueError(f"{wanted}, got {len(numbers)}")
    if not np.isfinite(numbers).all():
        raise ValueError(f"{wanted}, got {numbers.tolist()}")
    return numbers


def checked_rotation(values: Float[np.ndarray, " 9"]) -> Float[np.ndarray, "3 3"]:
    """The rotation matrix of nine numbers, row by row.

    Raises:
        ValueError: They are no rotation, or one with a reflection. The message is to stand after
            the key.
    """
    matrix = values.reshape(3, 3)
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > ORTHONORMAL:
        raise ValueError(
            f"must be a rotation (rows of length 1, at right angles), got {matrix.tolist()}"
        )
    if np.linalg.det(matrix) < 0:
        raise ValueError(f"must be a rotation without a reflection, got {matrix.tolist()}")
    return matrix
