"""The cameras of LLFF's `poses_bounds.npy`, which LLFF and Neural 3D Video captures share."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.io.safe.arrays import read_npy


POSES_FILE = "poses_bounds.npy"


def read_poses_bounds(path: Path) -> Float[np.ndarray, "cameras 17"]:
    """The rows of the file: a 3 x 5 matrix, and near and far distances, for each camera.

    Raises:
        FileNotFoundError: the file does not exist.
        CaptureError: it is no array of 17 real numbers a row.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: the file with the cameras' poses does not exist.")
    try:
        rows = read_npy(path)
    except ValueError as error:
        raise CaptureError(f"{path}: the file must be a NumPy array: {error}") from None
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind != "f":
        raise CaptureError(
            f"{path}: the array must be real numbers [cameras, 17], got {rows.dtype} "
            f"{list(rows.shape)}. Each row is a 3 x 5 matrix of LLFF, near and far."
        )
    return np.array(rows, np.float64)


def camera_keys(
    top: Keys, k: int, row: Float[np.ndarray, "17"], path: Path, size: tuple[int, int]
) -> Keys:
    """The camera of a row as the keys of a frame in a transforms.json.

    The row's matrix holds the camera's axes (down, right, backwards) and position as columns, then
    height, width and focal length in pixels. The optical axis meets the picture's centre.

    Args:
        top: the file of the rows, for messages.
        k: number of the row, which becomes the number of the frame.
        row: a 3 x 5 matrix, row by row, and near and far distances, which are not used.
        path: the camera's picture or video, after which the camera is named.
        size: width and height of the picture in pixels. It may be a scaled copy of the row's
            picture: the focal length is scaled by the ratio of the widths.

    Raises:
        CaptureError: height, width or focal length are not above 0, or the picture's aspect is not
            that of the row, to a pixel.
    """
    matrix = row[:15].reshape(3, 5)
    down, right, back, position = matrix[:, :4].T
    name = f"row {k} ({path.name})"
    pose = Keys(top.file, {name: np.stack([right, -down, back, position], axis=1)}).pose(name)
    height, width, focal = matrix[:, 4]
    if not (np.isfinite(matrix[:, 4]).all() and (matrix[:, 4] > 0).all()):
        raise CaptureError(
            f"{top.file}: {name} must hold a height, width and focal length above 0, got "
            f"{matrix[:, 4].tolist()}."
        )
    if abs(size[1] - height * size[0] / width) > 1:
        raise CaptureError(
            f"{path}: the pictures must have the shape of {width:g} x {height:g} that {POSES_FILE} "
            f"names, got {size[0]} x {size[1]}. Scale them without cropping."
        )
    focal *= size[0] / width
    return Keys(
        top.file,
        {
            **{"file_path": path.name, "camera": path.stem, "time": 0.0, "split": "train"},
            **{"transform_matrix": pose, "w": size[0], "h": size[1]},
            **{"fl_x": focal, "fl_y": focal, "cx": size[0] / 2, "cy": size[1] / 2},
        },
        k,
    )
