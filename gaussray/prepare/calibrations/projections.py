"""Projection matrices P = K [R | t]: the camera matrix and the pose that they are a product of."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gaussray.capture.camera_matrix import SLIGHT_SKEW, matrix_and_rotation
from gaussray.prepare.calibrations.known_camera import skew_remedy
from gaussray.prepare.calibrations.opencv_numbers import ORTHONORMAL
from gaussray.prepare.errors import PrepareError


# The smallest singular value of K R is at least this part of the largest: it is 1 / focal length
# and less for a principal point beside the picture.
_SINGULAR = 1e-9


def split_projection(
    where: str, key: str, numbers: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 4"]]:
    """K and [R | t] of a projection; focal lengths are positive.

    Args:
        where: the file, and the camera in it, for messages.
        key: what the file calls the projection.
        numbers: its 12 numbers row by row, or 16 with a last row 0 0 0 1.

    Raises:
        PrepareError: It is of no camera: its first three columns have no positive determinant, are
            a rotation without K, or have skew; or the last of four rows is not 0 0 0 1.
    """
    matrix = numbers.reshape(-1, 4)
    if len(matrix) == 4 and np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise PrepareError(
            f"{where}: {key} must be a projection K [R | t] to pixels, with no fourth row or "
            f"0 0 0 1, got the row {matrix[3].tolist()}. Write K, R and t instead."
        )
    square = matrix[:3, :3]
    sizes = np.linalg.svd(square, compute_uv=False)
    determinant = np.linalg.det(square / (sizes[0] or 1))
    if not sizes[-1] > _SINGULAR * sizes[0] or determinant < 0:
        got = "a negative one" if sizes[-1] > _SINGULAR * sizes[0] else "0"
        remedy = "Calibrate it again."
        if got != "0":
            remedy = (
                "Negate all its 12 numbers if points before the camera have a negative third "
                "coordinate; otherwise one axis is mirrored: negate it. Where rows count from the "
                "bottom of the picture, as in Argus and DLTdv before 8, write for the second row "
                "(rows of the picture - 1) times the third one minus the second one."
            )
        raise PrepareError(
            f"{where}: the first three columns of {key} must have a positive determinant, got "
            f"{got}. {remedy}"
        )
    if sizes[0] - sizes[-1] <= ORTHONORMAL * sizes[0]:
        raise PrepareError(
            f"{where}: {key} must be a projection K [R | t] to pixels, got a rotation and a "
            "translation without K. Write K beside it, and call it RT (world to camera)."
        )
    intrinsics, rotation = matrix_and_rotation(square)
    shift = rotation @ np.linalg.solve(square, matrix[:3, 3])
    if abs(intrinsics[0, 1]) > SLIGHT_SKEW * intrinsics[0, 0]:
        plain = np.where(np.eye(3), intrinsics, 0.0)
        plain[:, 2] = intrinsics[:, 2]
        turn = Rotation.from_matrix(rotation).as_rotvec()
        table = ", ".join(f"{name} = {_digits(array)}" for name, array in (
            ("matrix", plain), ("rotation", turn), ("translation", shift)))  # fmt: skip
        raise PrepareError(
            f"{where}: {key} must be a projection without skew, got {intrinsics[0, 1]:.4g} pixels "
            f"beside focal lengths of {intrinsics[0, 0]:.4g} and {intrinsics[1, 1]:.4g}. "
            f"Calibrate without skew. {skew_remedy(intrinsics)}: in a table of a .toml, with the "
            f"size of the pictures, {table}."
        )
    return intrinsics, np.column_stack([rotation, shift])


def _digits(array: Float[np.ndarray, "..."]) -> str:
    """An array as a list with eight digits of each number."""
    return np.array2string(array, separator=", ", formatter={"float": "{:.8g}".format}).replace(
        "\n", ""
    )
