"""TOML calibrations, as Pose2Sim, Anipose and aniposelib write: a table for each camera."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gaussray.io.safe.files import read_text
from gaussray.prepare.calibrations.known_camera import KnownCamera, check_name, opencv_camera
from gaussray.prepare.errors import PrepareError


def read_toml(path: Path) -> list[KnownCamera]:
    """The cameras of a TOML file: `name size matrix distortions rotation translation fisheye`.

    `rotation` is a Rodrigues vector; rotation and translation take world to camera (OpenCV).

    Raises:
        PrepareError: The file is no TOML, lists no camera, or a camera lacks a key.
    """
    try:
        content = tomllib.loads(read_text(path).decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PrepareError(f"{path}: must be TOML, got {error}.") from None
    tables = {k: v for k, v in content.items() if isinstance(v, dict) and "matrix" in v}
    if not tables:
        raise PrepareError(f"{path}: must have a table with a matrix for each camera, got none.")
    return [_camera(path, key, table) for key, table in tables.items()]


def _camera(path: Path, key: str, table: dict[str, Any]) -> KnownCamera:
    name = check_name(path, table.get("name", key))

    def array(field: str, *shape: int) -> np.ndarray:
        try:
            values = np.array(table[field], np.float64)
            return values.reshape(shape) if shape else values.ravel()
        except (KeyError, ValueError, TypeError):
            raise PrepareError(
                f"{path}: camera {name} must have {field} of {' x '.join(map(str, shape))} "
                f"numbers, got {str(table.get(field))[:80]}."
            ) from None

    rotation = Rotation.from_rotvec(array("rotation", 3)).as_matrix()
    pose = np.column_stack([rotation, array("translation", 3)])
    size = array("size", 2) if "size" in table else np.zeros(2)
    return opencv_camera(
        path,
        name,
        array("matrix", 3, 3),
        array("distortions") if "distortions" in table else np.zeros(4),
        pose,
        (int(size[0]), int(size[1])),
        fisheye=bool(table.get("fisheye", False)),
    )
