"""Captures of IDR and NeuS (Yariv et al. 2020, Wang et al. 2021): projections in `cameras.npz`.

DTU's and BlendedMVS' scenes come in this layout for reconstruction of surfaces.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.capture.camera_matrix import SLIGHT_SKEW, matrix_and_rotation
from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.llff import HELD_OUT_STEP
from gaussray.capture.formats.picture_places import KNOWN_SUFFIXES
from gaussray.capture.formats.transforms import points_of, views_of
from gaussray.capture.picture_file import picture_size
from gaussray.geometry import BLENDER_AXES
from gaussray.io.safe.arrays import read_npz


# Files of projections, the first of which is read: they differ in the region of the object alone.
CAMERA_FILES = ("cameras_sphere.npz", "cameras.npz")
_PICTURES, _MASKS = ("image", "images", "rgb"), "mask"


def neus_file(folder: Path) -> Path | None:
    """The file of projections of such a capture; None if the folder holds none, or no pictures."""
    if not any((folder / name).is_dir() for name in _PICTURES):
        return None
    return next((folder / name for name in CAMERA_FILES if (folder / name).is_file()), None)


def read_neus(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """A static capture: the i-th picture of `image/`, by name, has the projection `world_mat_i`.

    A projection is the 4 x 4 matrix whose first three rows take places in the world to pixels, K
    [R t] in OpenCV's axes; `scale_mat_i`, the region of the object, is not used. Every eighth
    picture, from the first, is held out. Of as many masks in `mask/`, white pixels count.

    Args:
        folder: the folder with cameras_sphere.npz or cameras.npz, `image/` and perhaps `mask/`.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a projection is none of a camera, or there are not as many as pictures.
        FileNotFoundError: no file of projections is there.
    """
    folder = Path(folder)
    path = neus_file(folder)
    if path is None:
        wanted = " or ".join(CAMERA_FILES)
        raise FileNotFoundError(f"{folder}: needs {wanted}, and pictures in image/.")
    try:
        arrays = read_npz(path)
    except ValueError as error:
        raise CaptureError(f"{path}: the file must hold arrays of NumPy: {error}") from None
    place = next(folder / name for name in _PICTURES if (folder / name).is_dir())
    pictures, masks = _pictures(place), _pictures(folder / _MASKS)
    count = sum(name.startswith("world_mat_") and name[10:].isdigit() for name in arrays)
    if count != len(pictures) or not count:
        raise CaptureError(
            f"{path}: must hold a projection world_mat_0, ... for each picture of {place.name}/, "
            f"got {count} and {len(pictures)}. Copy what is missing, or remove the others."
        )
    top = Keys(path, {})
    if len(masks) == count:
        top.warn(f"white pixels of {_MASKS}/ count. Rename the folder to use all pixels.")
    frames = []
    for k, picture in enumerate(pictures):
        width, height = picture_size(picture)
        keys = {"file_path": picture.relative_to(folder).as_posix(), "w": width, "h": height}
        keys |= {"camera": picture.stem, "time": 0.0}
        keys["split"] = "train" if k % HELD_OUT_STEP else "test"
        if len(masks) == count:
            keys["mask_path"] = masks[k].relative_to(folder).as_posix()
        frames.append(Keys(path, {**keys, **_camera(path, k, arrays)}, k))
    top.warn(f"a capture of pictures at one time; each {HELD_OUT_STEP}th of {count} is held out.")
    views = views_of(top, frames, dtype)
    return Capture(folder, views, {}, points_of(top), (0.0, 0.0), "normalised")


def _pictures(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in KNOWN_SUFFIXES)


def _camera(path: Path, index: int, arrays: dict[str, np.ndarray]) -> dict[str, object]:
    """Focal lengths, principal point and pose of a projection, as keys of a frame.

    K R is a product of an upper triangular matrix and a rotation, which is unique up to signs:
    focal lengths are positive, and a projection means the same times any number.
    """
    name = f"world_mat_{index}"
    matrix = arrays.get(name)
    keys = Keys(path, {name: None if matrix is None else matrix.tolist()}, index)
    rule = "a 3 x 4 or 4 x 4 projection K [R t] without skew, of finite numbers"
    if matrix is None or matrix.shape not in ((4, 4), (3, 4)) or matrix.dtype.kind != "f":
        raise keys.error(name, rule)
    projection = matrix[:3].astype(np.float64)
    if not np.isfinite(projection).all() or not np.linalg.matrix_rank(projection[:, :3]) == 3:
        raise keys.error(name, rule)
    if np.linalg.det(projection[:, :3]) < 0:
        projection = -projection
    intrinsics, rotation = matrix_and_rotation(projection[:, :3])
    if abs(intrinsics[0, 1]) > SLIGHT_SKEW * intrinsics[0, 0]:
        raise keys.error(name, rule)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = rotation.T * np.array(BLENDER_AXES)
    world_from_camera[:3, 3] = -np.linalg.solve(projection[:, :3], projection[:, 3])
    return {
        "transform_matrix": world_from_camera,
        **{"fl_x": float(intrinsics[0, 0]), "fl_y": float(intrinsics[1, 1])},
        **{"cx": float(intrinsics[0, 2]), "cy": float(intrinsics[1, 2])},
    }
