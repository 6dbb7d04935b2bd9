"""Reads tables of viewing directions from untrusted .npz and .exr files."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from gaussray.io.safe.arrays import read_npz


# Lengths of unit vectors differ from 1 by less than the first in single precision, and stay as they
# are; by less than the second in half precision, and are normalised.
EXACT, NEAR = 1e-6, 2e-3


def read_ray_map(path: Path | str) -> Float[np.ndarray, "rows columns 3"]:
    """Directions in camera axes (+x right, +y down, +z forward), zero where there is no ray.

    Args:
        path: an .npz file with the array `rays`, or an .exr file with three channels. The table
            divides the picture into equal cells and holds the direction at each cell's middle.

    Raises:
        ValueError: If the file holds no such table; the message names the file. Whether the table
            is a valid lens is checked by `RayTable`.
        OSError: If the file is missing or cannot be read.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: lens.file does not exist.")
    if path.suffix == ".npz":
        rays = _npz(path)
    elif path.suffix == ".exr":
        rays = _exr(path)
    else:
        raise ValueError(f"{path}: lens.file must be an .npz or .exr file.")
    if rays.ndim != 3 or rays.shape[2] != 3 or rays.dtype.kind != "f":
        raise ValueError(
            f"{path}: lens.file must hold numbers [rows, columns, 3], got {rays.dtype} "
            f"{list(rays.shape)}."
        )
    if not np.isfinite(rays).all():
        raise ValueError(f"{path}: lens.file must be finite. Write zeros where there is no ray.")
    length = np.linalg.norm(rays.astype(np.float64), axis=-1, keepdims=True)
    off = np.abs(length - 1)
    return np.where((off > EXACT) & (off < NEAR), rays / np.where(length > 0, length, 1), rays)


def _npz(path):
    try:
        found = read_npz(path)
    except ValueError as error:
        raise ValueError(f"{path}: lens.file is no .npz file: {error}") from error
    if "rays" not in found:
        raise ValueError(f"{path}: lens.file must hold an array `rays`, got {[*found][:9]}.")
    return found["rays"]


def _exr(path):
    # Here, so that lenses and the tracer need no OpenImageIO.
    from gaussray.io.safe.pictures import complaint, open_picture

    try:
        file = open_picture(path)
    except (OSError, ValueError) as error:
        kind = OSError if isinstance(error, OSError) else ValueError
        reason = str(error).removeprefix(f"{path}: ")
        raise kind(f"{path}: lens.file cannot be read: {reason}") from None
    rays = file.read_image("float")
    file.close()
    if rays is None:
        raise OSError(f"{path}: lens.file cannot be read: {complaint(file)}")
    return rays
