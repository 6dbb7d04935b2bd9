"""OpenCV's YAML files intri.yml and extri.yml, as EasyMocap and ZJU-MoCap have them."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from gaussray.io.safe.aliases import check_aliases
from gaussray.io.safe.files import read_text
from gaussray.prepare.calibrations.known_camera import KnownCamera, check_name, opencv_camera
from gaussray.prepare.errors import PrepareError


INTRINSICS_FILE, EXTRINSICS_FILE = "intri.yml", "extri.yml"


class _Loader(yaml.SafeLoader):
    """Reads plain YAML and OpenCV's matrices."""


def _matrix(loader: _Loader, node: Any) -> np.ndarray:
    values = loader.construct_mapping(node, deep=True)
    data = np.array(values["data"], np.float64)
    return data.reshape(int(values["rows"]), int(values["cols"]))


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def read_easymocap(folder: Path) -> list[KnownCamera]:
    """The cameras of intri.yml (`K_cam`, `dist_cam`) and extri.yml (`R_cam` a Rodrigues vector or
    matrix or `Rot_cam` a matrix, `T_cam`), by the `names` that the files list.

    Raises:
        PrepareError: A file is no YAML of OpenCV, or lacks a matrix.
    """
    inner, outer = (read_opencv_yaml(folder / n) for n in (INTRINSICS_FILE, EXTRINSICS_FILE))
    names = outer.get("names") or inner.get("names") or []
    if not isinstance(names, list) or not names:
        raise PrepareError(
            f"{folder / EXTRINSICS_FILE}: must list the cameras as names, got {str(names)[:80]}."
        )
    return [_camera(folder, check_name(folder, name), inner, outer) for name in names]


def read_opencv_yaml(path: Path) -> dict[str, Any]:
    """The values of a YAML file that cv::FileStorage has written; matrices are arrays."""
    text = read_text(path).decode("utf-8", "replace")
    # OpenCV's first line, %YAML:1.0, is no directive of YAML.
    lines = text.splitlines()
    if lines and lines[0].startswith("%YAML"):
        lines = lines[1:]
    body = "\n".join(line for line in lines if line.strip() != "---")
    try:
        check_aliases(path, body)
        content = yaml.load(body, Loader=_Loader)
    except (yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise PrepareError(f"{path}: must be YAML of OpenCV, got {reason}.") from None
    if not isinstance(content, dict):
        raise PrepareError(f"{path}: must be YAML of OpenCV with keys, got none.")
    return content


def _camera(folder: Path, name: str, inner: dict, outer: dict) -> KnownCamera:
    def matrix(content: dict, file: str, keys: tuple[str, ...], sizes: tuple[int, ...]):
        for key in keys:
            value = content.get(f"{key}_{name}")
            if isinstance(value, np.ndarray) and value.size in sizes:
                return value
        raise PrepareError(
            f"{folder / file}: camera {name} must have {' or '.join(keys)}_{name} of "
            f"{' or '.join(map(str, sizes))} numbers, got none."
        )

    turn = matrix(outer, EXTRINSICS_FILE, ("Rot", "R"), (9, 3))
    if turn.size == 3:
        turn = Rotation.from_rotvec(turn.ravel()).as_matrix()
    pose = np.column_stack(
        [turn.reshape(3, 3), matrix(outer, EXTRINSICS_FILE, ("T",), (3,)).ravel()]
    )
    distortion = inner.get(f"dist_{name}", inner.get(f"D_{name}", np.zeros(4)))
    size = [int(inner.get(f"{key}_{name}", 0) or 0) for key in ("W", "H")]
    return opencv_camera(
        folder,
        name,
        matrix(inner, INTRINSICS_FILE, ("K",), (9,)).reshape(3, 3),
        np.array(distortion, np.float64).ravel(),
        pose,
        (size[0], size[1]),
    )
