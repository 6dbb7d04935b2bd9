"""Projection matrices P = K [R | t]: the camera matrix and the pose that they are a product of."""

from collections.abc import Sequence
from typing import NoReturn

import numpy as np
from jaxtyping import Float

from gaussray.capture.camera_matrix import SLIGHT_SKEW, matrix_and_rotation
from gaussray.prepare.calibrations.opencv_numbers import ORTHONORMAL
from gaussray.prepare.calibrations.value_names import DLT_KEY
from gaussray.prepare.errors import PrepareError


# The smallest singular value of K R is at least this part of the largest: it is 1 / focal length
# and less for a principal point beside the picture.
_SINGULAR = 1e-9
# Skew is left out if that costs at most so many pixels at the border of the picture. The principal
# point is taken to be in the middle of the rows, and at least so many from the border.
_PIXELS, _ROWS = 1.0, 100.0


class SkewedProjection(PrepareError):
    """A projection has skew that costs too many pixels to leave out.

    Args:
        told: the file, the camera in it, the key and its skew, in words.
        cost: the pixels that it costs to leave it out, and where.
        numbers: those to write then, row by row.
    """

    def __init__(self, told: str, cost: str, numbers: str):
        super().__init__(
            f"{told}. Calibrate without skew; or, if {cost} do not matter, write in its place, row "
            f"by row, {numbers}"
        )
        self.cost, self.numbers = cost, numbers


def split_projection(
    where: str, key: str, numbers: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 4"]]:
    """K without skew, with positive focal lengths, and [R | t] of a projection.

    Skew is left out where that costs at most a pixel at the border of the picture (`skew_cost`), or
    it is at most a thousandth of the focal length.

    Args:
        where: the file, and the camera in it, for messages.
        key: what the file calls the projection.
        numbers: its 12 numbers row by row, or 16 with a last row 0 0 0 1.

    Raises:
        SkewedProjection: It has more skew.
        PrepareError: It is of no camera: its first three columns have no positive determinant, or
            are a rotation without K; or the last of four rows is not 0 0 0 1.
    """
    matrix = numbers.reshape(-1, 4)
    if len(matrix) == 4 and np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise PrepareError(
            f"{where}: {key} must be a projection K [R | t] to pixels, with no fourth row or "
            f"0 0 0 1, got the row {matrix[3].tolist()}. Write K, R and t instead."
        )
    square = matrix[:3, :3]
    rule = f"{where}: the first three columns of {key} must have a positive determinant"
    if _is_singular(square):
        raise PrepareError(f"{rule}, got 0. Calibrate it again.")
    if np.linalg.det(_scaled(square)) < 0:
        raise PrepareError(
            f"{rule}, got a negative one. Negate all its 12 numbers if points before the camera "
            "have a negative third coordinate; otherwise one axis is mirrored: negate it. Where "
            "rows count from the bottom of the picture, as in Argus and DLTdv before 8, write for "
            "the second row (rows of the picture - 1) times the third one minus the second one."
        )
    sizes = np.linalg.svd(square, compute_uv=False)
    if sizes[0] - sizes[-1] <= ORTHONORMAL * sizes[0]:
        raise PrepareError(
            f"{where}: {key} must be a projection K [R | t] to pixels, got a rotation and a "
            "translation without K. Write K beside it, and call it RT (world to camera)."
        )
    intrinsics, rotation = matrix_and_rotation(square)
    pose = np.column_stack([rotation, rotation @ np.linalg.solve(square, matrix[:3, 3])])
    plain = np.where(np.eye(3), intrinsics, 0.0)
    plain[:, 2] = intrinsics[:, 2]
    rows, cost = _rows_and_cost(intrinsics)
    if cost > _PIXELS and abs(intrinsics[0, 1]) > SLIGHT_SKEW * intrinsics[0, 0]:
        told = (
            f"{where}: {key} must be a projection without skew, got {intrinsics[0, 1]:.4g} pixels "
            f"beside focal lengths of {intrinsics[0, 0]:.4g} and {intrinsics[1, 1]:.4g}"
        )
        away = f"{cost:.2g} pixels {rows:.0f} rows from row {intrinsics[1, 2]:.0f}"
        raise SkewedProjection(told, away, _digits(plain @ pose, key == DLT_KEY))
    return plain, pose


def refuse_skewed(errors: Sequence[tuple[str, SkewedProjection]]) -> NoReturn:
    """Refuse the projections of a file or folder that have skew, with the numbers to write in the
    place of each.

    Args:
        errors: the name of each such camera, and what is said of it.

    Raises:
        PrepareError: Always.
    """
    (_, first), *others = errors
    rest = "".join(
        f" So has camera {name} ({error.cost}): write {error.numbers}." for name, error in others
    )
    raise PrepareError(f"{first}.{rest}") from None


def skew_cost(numbers: Float[np.ndarray, " n"]) -> float:
    """Pixels that a 0 in the place of the skew of a projection costs at the border of the picture.

    The border is taken to be as far as the principal point is from row 0, which is true of one in
    the middle, and at least 100 rows from it.

    Args:
        numbers: its 12 numbers, or 16, of a camera (`split_projection`).
    """
    return _rows_and_cost(matrix_and_rotation(numbers.reshape(-1, 4)[:3, :3])[0])[1]


def dlt_projection(coefficients: Float[np.ndarray, "11"]) -> Float[np.ndarray, "12"]:
    """The 12 numbers of the projection of a direct linear transform (DLT).

    The twelfth is 1, which forces the sign of all upon them: where the origin of the world lies
    behind the camera it is the wrong one. So the sign is that of which the first three columns have
    a positive determinant. A mirrored picture (rows that count from the bottom) has one as well,
    with the other sign, and turns the camera around: `check_dlts` tells that from the others.

    Args:
        coefficients: L1 to L11.
    """
    numbers = np.append(coefficients, 1.0)
    determinant = np.linalg.det(_scaled(numbers.reshape(3, 4)[:, :3]))
    return -numbers if determinant < 0 else numbers


def focal_lengths(numbers: Float[np.ndarray, "12"]) -> tuple[float, float]:
    """Both focal lengths of a projection in pixels; 0 if it is of no camera, because the
    determinant of its first three columns is 0 beside their size.

    Args:
        numbers: its numbers row by row, as large as they may be.
    """
    square = _scaled(numbers.reshape(3, 4)[:, :3])
    if _is_singular(square):
        return 0.0, 0.0
    intrinsics, _ = matrix_and_rotation(square)
    return float(intrinsics[0, 0]), float(intrinsics[1, 1])


def _scaled(square: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """A matrix whose largest number is 1 or -1, so that products do not overflow; zeros stay."""
    return square / (np.abs(square).max() or 1.0)


def _is_singular(square: Float[np.ndarray, "3 3"]) -> bool:
    """Whether the determinant is 0 beside the size of the numbers."""
    sizes = np.linalg.svd(square, compute_uv=False)
    return not sizes[-1] > _SINGULAR * sizes[0]


def _rows_and_cost(intrinsics: Float[np.ndarray, "3 3"]) -> tuple[float, float]:
    """Rows from the principal point to the border, and pixels that skew moves the latter."""
    rows = max(abs(intrinsics[1, 2]), _ROWS)
    return rows, abs(intrinsics[0, 1]) * rows / intrinsics[1, 1]


def _digits(matrix: Float[np.ndarray, "3 4"], dlt: bool) -> str:
    """The numbers of a projection row by row; those of a DLT but for the last, which is 1."""
    numbers = (matrix / matrix[2, 3]).ravel()[:-1] if dlt else matrix.ravel()
    return " ".join(f"{number:.12g}" for number in numbers)
