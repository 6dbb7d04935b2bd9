"""What every reader of calibrations returns: cameras with their lens and pose."""

import dataclasses
import re
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gaussray.capture.camera_matrix import SLIGHT_SKEW
from gaussray.prepare.calibrations.distortions import OPENCV_ORDER
from gaussray.prepare.calibrations.opencv_numbers import ORTHONORMAL
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.lens_models import LensKeyValues


# Where all files that are read are listed, for messages.
ALL_KINDS = "docs/prepare.md#a-calibration-with-poses lists all kinds."
# How to give a calibration of another kind.
TOML_RECIPE = (
    "Write its cameras to a .toml with a table for each, [cam_0], that has matrix, distortions, "
    "size, rotation and translation (OpenCV's, world to camera)"
)
JSON_RECIPE = (
    "Give each camera, under its name, finite numbers for K (3 x 3), R and t (OpenCV's, world to "
    "camera), dist and size"
)
# The last row of a camera matrix may differ from (0, 0, 1) by this, where text has few digits.
_LAST_ROW = 1e-3
# Larger numbers make no camera, and their squares may overflow.
_HUGE = 1e12
# Most columns and rows of a picture.
_MOST = 10**6


@dataclasses.dataclass(frozen=True, eq=False)
class KnownCamera:
    """A calibrated camera.

    Args:
        name: its name in the file.
        lens: keys of a capture's JSON; pixel centres at 0.5. `w` and `h` are 0 where the file does
            not say them.
        pose: world to camera [3, 4], OpenCV axes.
    """

    name: str
    lens: LensKeyValues
    pose: Float[np.ndarray, "3 4"]


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """What a file says about the cameras of a rig.

    Args:
        cameras: those that have a lens and a pose.
        left_out: for each other camera, by name, what the file lacks or says of it.
        is_pair: the file is of two cameras, the left or first one and the other, without names of
            videos.
        in_order: the cameras have no names but an order, that of the input's cameras.
    """

    cameras: list[KnownCamera]
    left_out: dict[str, str] = dataclasses.field(default_factory=dict)
    is_pair: bool = False
    in_order: bool = False


def opencv_camera(
    where: object,
    name: str,
    matrix: Float[np.ndarray, "3 3"],
    distortion: Float[np.ndarray, " n"],
    pose: Float[np.ndarray, "3 4"],
    size: tuple[float, float] = (0, 0),
    *,
    fisheye: bool = False,
) -> KnownCamera:
    """A camera from OpenCV's parameters, whose pixel centres are at whole numbers (here at 0.5).

    Args:
        where: the file or folder that messages name.
        name: its name in the file.
        matrix: camera matrix with focal lengths and principal point in pixels.
        distortion: coefficients in OpenCV's order; missing ones are 0.
        pose: world to camera, OpenCV axes, translation in scene units.
        size: width and height of the calibrated pictures in pixels; 0 if the file does not say.
        fisheye: OpenCV's fisheye model with k1 to k4, instead of k1, k2, p1, p2, k3 to k6.

    Raises:
        PrepareError: A number is not finite or too large, a focal length is not positive, the last
            row of `matrix` is not (0, 0, 1), `matrix` has skew, `pose` has no rotation or one with
            a reflection, a coefficient that the lens model does not have is not 0, or `size` is
            neither 0 nor whole numbers from 1 to 10^6.
    """
    values = np.concatenate([matrix.ravel(), distortion.ravel(), pose.ravel()])
    turn = pose[:, :3]
    if not np.all(np.abs(values) <= _HUGE):
        raise PrepareError(
            f"{where}: camera {name} must have finite numbers of at most {_HUGE:g}, got "
            f"{values[~(np.abs(values) <= _HUGE)][0]:g}. Calibrate it again."
        )
    unequal = np.abs(turn @ turn.T - np.eye(3)).max()
    if unequal > ORTHONORMAL or min(matrix[0, 0], matrix[1, 1]) <= 0:
        raise PrepareError(
            f"{where}: camera {name} must have positive focal lengths and a rotation, got matrix "
            f"{matrix.tolist()} and rotation {turn.tolist()}. Calibrate it again."
        )
    if np.linalg.det(turn) < 0:
        raise PrepareError(
            f"{where}: the rotation of camera {name} must have determinant 1, got -1: one axis is "
            "mirrored. Negate it in all cameras: the column of R for an axis of the world, or the "
            "row of R with its number of t for an axis of the camera."
        )
    if np.abs(matrix[2] - (0, 0, 1)).max() > _LAST_ROW:
        raise PrepareError(
            f"{where}: the matrix of camera {name} must end with the row 0 0 1, got "
            f"{matrix.tolist()}. Is it transposed? Write it row by row: fx 0 cx, 0 fy cy, 0 0 1."
        )
    if abs(matrix[0, 1]) > SLIGHT_SKEW * matrix[0, 0]:
        raise PrepareError(
            f"{where}: the matrix of camera {name} must have no skew, got {matrix[0, 1]:.4g} "
            f"pixels beside a focal length of {matrix[0, 0]:.4g}. Calibrate without "
            f"skew: no lens model here has it. {skew_remedy(matrix, size[1])}."
        )
    if any(size) and not all(1 <= side <= _MOST and side == int(side) for side in size):
        raise PrepareError(
            f"{where}: the size of camera {name} must be two whole numbers from 1 to {_MOST} "
            f"(columns and rows), got {size[0]:g} x {size[1]:g}. Correct or remove it."
        )
    order = ("k1", "k2", "k3", "k4") if fisheye else OPENCV_ORDER
    if len(distortion) > len(order):
        if np.any(distortion[len(order) :]):
            remedy = "Calibrate without thin prism and tilt."
            if fisheye:
                remedy = "OpenCV's fisheye has k1 to k4: correct its model or its coefficients."
            raise PrepareError(
                f"{where}: camera {name} must have at most {len(order)} distortion coefficients, "
                f"got {len(distortion)}. {remedy}"
            )
        distortion = distortion[: len(order)]
    coefficients = dict(zip(order, map(float, distortion), strict=False))
    lens = {
        "camera_model": "OPENCV_FISHEYE" if fisheye else "FULL_OPENCV",
        **{"w": int(size[0]), "h": int(size[1])},
        **{"fl_x": float(matrix[0, 0]), "fl_y": float(matrix[1, 1])},
        **{"cx": float(matrix[0, 2]) + 0.5, "cy": float(matrix[1, 2]) + 0.5},
        **coefficients,
    }
    # The simplest model that has all coefficients.
    if not fisheye and not any(coefficients.get(key, 0.0) for key in OPENCV_ORDER[4:]):
        lens = {key: value for key, value in lens.items() if key not in OPENCV_ORDER[4:]}
        lens["camera_model"] = "OPENCV"
    return KnownCamera(name, lens, pose)


def skew_remedy(matrix: Float[np.ndarray, "3 3"], height: float = 0) -> str:
    """What to do about a camera matrix with skew, with the pixels that a 0 in its place costs.

    Args:
        matrix: the camera matrix.
        height: rows of the picture; 0 if they are not known.
    """
    farthest = max(matrix[1, 2], height - matrix[1, 2]) if height else 100.0
    pixels = abs(matrix[0, 1]) * farthest / matrix[1, 1]
    where = "at the upper and lower border of the picture"
    if not height:
        where = f"for each 100 rows above or below row {matrix[1, 2]:.0f}"
    return f"Or write 0 in its place, if {pixels:.2g} pixels {where} do not matter"


def refuse_distortion(where: object, name: object, keys: Collection[object]) -> None:
    """Refuse keys of a camera that may be of its distortion, but are not read.

    Args:
        where: the file that the message names.
        name: the camera.
        keys: the keys that are not read.

    Raises:
        PrepareError: A key has `dist` in it, and not of a distance.
    """
    words = (str(key) for key in keys)
    unread = next((key for key in words if re.search("dist(?!anc)", key.lower())), None)
    if unread is not None:
        raise PrepareError(
            f"{where}: {unread[:80]} of camera {name} is not read, and may be of its distortion. "
            "Call OpenCV's coefficients (k1 k2 p1 p2 k3) dist, and remove what is none of them."
        )


def check_name(where: Path, name: object) -> str:
    """The name of a camera as text.

    Args:
        where: the file or folder that messages name.
        name: what the file gives as the name.

    Raises:
        PrepareError: The text is empty or longer than 200 characters.
    """
    text = str(name)
    if not 0 < len(text) <= 200:
        raise PrepareError(
            f"{where}: a camera must have a name of 1 to 200 letters, got {text[:80]!r}. Rename it."
        )
    return text


def check_distinct_names(path: Path, names: Sequence[str]) -> None:
    """Check that no two cameras have one name.

    Args:
        path: the file that has them, for the message.
        names: their names.

    Raises:
        PrepareError: Two have one name.
    """
    twice, count = Counter(names).most_common(1)[0] if names else ("", 0)
    if count > 1:
        raise PrepareError(
            f"{path}: each camera must have a name of its own, got {twice[:80]} twice. Change one."
        )
