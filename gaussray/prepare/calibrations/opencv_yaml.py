"""Pairs of OpenCV's YAML files, as EasyMocap, ZJU-MoCap and Pose2Sim's converter have them."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from gaussray.io.safe.aliases import check_aliases
from gaussray.io.safe.files import read_text
from gaussray.prepare.calibrations.known_camera import KnownCamera, check_name, opencv_camera
from gaussray.prepare.errors import PrepareError


# Names of both files, in lower case: EasyMocap's, and those of Pose2Sim's converter to EasyMocap.
_PAIRS = (("intri.yml", "extri.yml"), ("intrinsic.yml", "extrinsic.yml"))
_REMEDY = "Write both files with cv::FileStorage: K and dist in one, R (or Rot) and T in the other."


class _Loader(yaml.SafeLoader):
    """Reads plain YAML and OpenCV's matrices."""


def _matrix(loader: _Loader, node: Any) -> np.ndarray:
    values = loader.construct_mapping(node, deep=True)
    # OpenCV 5 gives the sizes of vectors; before, they were matrices of one column.
    sizes = values["sizes"] if "sizes" in values else (values["rows"], values["cols"])
    return np.array(values["data"], np.float64).reshape([int(size) for size in sizes])


# What values of a wrong kind, size or depth raise.
_UNUSABLE = (KeyError, TypeError, ValueError, OverflowError, RecursionError)
# FileStorage's spelling of no number is not YAML's.
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(r"\.Nan$"), ["."])
for _tag in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _matrix)


def easymocap_pair(path: Path) -> tuple[Path, Path] | None:
    """The file of intrinsics and that of extrinsics in a folder, or with one of the two, whatever
    the case of their names; None if `path` is neither.

    Raises:
        PrepareError: `path` is one of the two and the other is not beside it.
    """
    folder = path if path.is_dir() else path.parent
    files = {file.name.lower(): file for file in sorted(folder.iterdir()) if file.is_file()}
    for pair in _PAIRS:
        missing = [name for name in pair if name not in files]
        if not path.is_dir() and path.name.lower() in pair and missing:
            raise PrepareError(
                f"{path}: {missing[0]} must be beside it, got no such file. Copy it there."
            )
        if not missing and (path.is_dir() or path.name.lower() in pair):
            return files[pair[0]], files[pair[1]]
    return None


def read_easymocap(intrinsics: Path, extrinsics: Path) -> list[KnownCamera]:
    """The cameras of a pair of files, by the `names` that the files list.

    The first has `K_cam` and `dist_cam` (or `D_cam`), the second `R_cam` (a Rodrigues vector or a
    matrix) or `Rot_cam` (a matrix), and `T_cam`. `cam` is the name of the camera; where a file has
    no such keys, its number in `names`, from 1, as Pose2Sim's converter writes.

    Args:
        intrinsics: the file of camera matrices and distortion.
        extrinsics: the file of rotations and translations, world to camera (OpenCV).

    Raises:
        PrepareError: A file is no YAML of OpenCV, or lacks a matrix.
    """
    inner, outer = read_opencv_yaml(intrinsics), read_opencv_yaml(extrinsics)
    names = outer.get("names") or inner.get("names") or []
    if not isinstance(names, list) or not names:
        raise PrepareError(
            f"{extrinsics}: must list the cameras as names, got {str(names)[:80]}. Add the list, "
            "as in names: [cam0, cam1]."
        )
    checked = [check_name(extrinsics, name) for name in names]
    files = (
        _KeyedFile(intrinsics, inner, _suffixes(inner, "K", checked)),
        _KeyedFile(extrinsics, outer, _suffixes(outer, "T", checked)),
    )
    return [_camera(name, *files) for name in checked]


def read_opencv_yaml(path: Path, remedy: str = _REMEDY) -> dict[str, Any]:
    """The values of a YAML file that cv::FileStorage has written; matrices are arrays.

    Args:
        path: the file.
        remedy: what to write instead, for messages.

    Raises:
        PrepareError: the file is no YAML with keys.
    """
    text = read_text(path).decode("utf-8-sig", "replace")
    # OpenCV's first line, %YAML:1.0, is no directive of YAML.
    lines = text.splitlines()
    if lines and lines[0].startswith("%YAML"):
        lines = lines[1:]
    body = "\n".join(line for line in lines if line.strip() != "---")
    try:
        check_aliases(path, body)
        content = yaml.load(body, Loader=_Loader)
    except (yaml.YAMLError, *_UNUSABLE) as error:
        reason = " ".join(str(error).split())[:200]
        raise PrepareError(f"{path}: must be YAML of OpenCV, got {reason}. {remedy}") from None
    if not isinstance(content, dict):
        raise PrepareError(f"{path}: must be YAML of OpenCV with keys, got none. {remedy}")
    return content


def _suffixes(content: dict[str, Any], key: str, names: list[str]) -> dict[str, str]:
    """What follows `K_` in the keys of each camera: its name, or its number in the file's list."""
    if any(f"{key}_{name}" in content for name in names):
        return {name: name for name in names}
    listed = content.get("names")
    order = [str(name) for name in listed] if isinstance(listed, list) and listed else names
    return {name: str(number) for number, name in enumerate(order, 1)}


@dataclasses.dataclass(frozen=True)
class _KeyedFile:
    """The values of one file, and what follows the `_` in the keys of each camera."""

    path: Path
    content: dict[str, Any]
    suffix: dict[str, str]

    def value(self, key: str, name: str) -> Any:
        return self.content.get(f"{key}_{self.suffix.get(name, name)}")

    def matrix(self, keys: tuple[str, ...], name: str, sizes: tuple[int, ...]) -> np.ndarray:
        for key in keys:
            value = self.value(key, name)
            if isinstance(value, np.ndarray) and value.size in sizes:
                return value
        raise PrepareError(
            f"{self.path}: camera {name} must have {' or '.join(keys)}_"
            f"{self.suffix.get(name, name)} of {' or '.join(map(str, sizes))} numbers, got none. "
            f"{_REMEDY}"
        )


def _camera(name: str, inner: _KeyedFile, outer: _KeyedFile) -> KnownCamera:
    turn = outer.matrix(("Rot", "R"), name, (9, 3))
    if turn.size == 3:
        turn = Rotation.from_rotvec(turn.ravel()).as_matrix()
    pose = np.column_stack([turn.reshape(3, 3), outer.matrix(("T",), name, (3,)).ravel()])
    found = [inner.value(key, name) for key in ("dist", "D")]
    distortion = next((value for value in found if value is not None), np.zeros(4))
    size = [int(inner.value(key, name) or 0) for key in ("W", "H")]
    return opencv_camera(
        inner.path,
        name,
        inner.matrix(("K",), name, (9,)).reshape(3, 3),
        np.array(distortion, np.float64).ravel(),
        pose,
        (size[0], size[1]),
    )
