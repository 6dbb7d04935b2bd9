"""TOML calibrations, as Pose2Sim, Anipose, aniposelib and Caliscope write: a table per camera."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gaussray.io.safe.files import read_text
from gaussray.prepare.calibrations.known_camera import (
    Calibration,
    KnownCamera,
    check_distinct_names,
    check_name,
    opencv_camera,
)
from gaussray.prepare.errors import PrepareError


_NEEDS = (
    "Each camera needs a table, [cam_0] or [cameras.0], with matrix (3 x 3), distortions, size "
    "(columns and rows) and, from world to camera, rotation (a Rodrigues vector or 3 x 3) and "
    "translation (3 numbers)."
)


def read_toml(path: Path) -> Calibration:
    """The cameras of a TOML file: `name size matrix distortions rotation translation fisheye`.

    `rotation` is a Rodrigues vector or a matrix; rotation and translation take world to camera
    (OpenCV). The tables are at the top level or, as Caliscope has them, in `cameras`, where a
    number N stands for `cam_N`. Cameras that are marked `ignore` or have no matrix, rotation or
    translation (`"null"` counts as none) are left out.

    Raises:
        PrepareError: The file is no TOML, lists no camera with a pose, or a value has not the
            numbers that it needs.
    """
    try:
        content = tomllib.loads(read_text(path).decode("utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PrepareError(f"{path}: must be TOML, got {error}. {_NEEDS}") from None
    tables = _tables(path, content)
    if not tables:
        listed = ", ".join(f"[{key}]" for key in list(content)[:9]) or "an empty file"
        raise PrepareError(
            f"{path}: must have a table with a matrix for each camera, got {listed}. {_NEEDS}"
        )
    reasons = {name: _reason(table) for name, table in tables.items()}
    left_out = {name: reason for name, reason in reasons.items() if reason}
    if len(left_out) == len(tables):
        listed = "; ".join(f"{name} {reason}" for name, reason in list(left_out.items())[:9])
        raise PrepareError(
            f"{path}: must have a camera with a pose, got none: {listed}. Finish the calibration "
            f"of the cameras' poses (extrinsics), and give the file that has them. {_NEEDS}"
        )
    cameras = [_camera(path, name, t) for name, t in tables.items() if name not in left_out]
    return Calibration(cameras, left_out)


def _tables(path: Path, content: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The tables of cameras by the camera's name; other tables are of boards and the like."""
    nested = content.get("cameras")
    if isinstance(nested, dict) and any(isinstance(value, dict) for value in nested.values()):
        named = {f"cam_{k}" if k.isdecimal() else k: table for k, table in nested.items()}
        tables = {name: table for name, table in named.items() if isinstance(table, dict)}
    else:
        found = {k: v for k, v in content.items() if isinstance(v, dict) and "matrix" in v}
        names = [str(table.get("name", key)) for key, table in found.items()]
        check_distinct_names(path, names)
        tables = dict(zip(names, found.values(), strict=True))
    return {check_name(path, name): table for name, table in tables.items()}


def _reason(table: dict[str, Any]) -> str:
    """Why a camera cannot be used, to stand after its name; empty if it can."""
    if table.get("ignore") is True:
        return "is marked ignore"
    fields = ("matrix", "rotation", "translation")
    missing = [field for field in fields if _is_absent(table.get(field))]
    return f"has no {' and no '.join(missing)}" if missing else ""


def _is_absent(value: Any) -> bool:
    """Whether a value stands for none: Caliscope has written null as text, and empty lists."""
    return value is None or value == "null" or value == []


def _camera(path: Path, name: str, table: dict[str, Any]) -> KnownCamera:
    def array(field: str, *counts: int) -> np.ndarray:
        try:
            values = np.array(table[field], np.float64).ravel()
        except (KeyError, ValueError, TypeError):
            values = np.array([np.nan])
        if not np.isfinite(values).all() or (counts and len(values) not in counts):
            wanted = f"{' or '.join(map(str, counts))} numbers" if counts else "numbers"
            raise PrepareError(
                f"{path}: camera {name} must have {field} of {wanted}, got "
                f"{str(table.get(field))[:80]}. {_NEEDS}"
            )
        return values

    turn = array("rotation", 3, 9)
    if len(turn) == 3:
        turn = Rotation.from_rotvec(turn).as_matrix()
    size = (0, 0) if _is_absent(table.get("size")) else array("size", 2)
    return opencv_camera(
        path,
        name,
        array("matrix", 9).reshape(3, 3),
        np.zeros(4) if _is_absent(table.get("distortions")) else array("distortions"),
        np.column_stack([turn.reshape(3, 3), array("translation", 3)]),
        (float(size[0]), float(size[1])),
        fisheye=table.get("fisheye") is True,
    )
