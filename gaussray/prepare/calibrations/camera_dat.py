"""Pairs of text files for each camera, as TemugeB's programs write: camera0_intrinsics.dat with
camera0_rot_trans.dat, or c0.dat with rot_trans_c0.dat."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gaussray.io.safe.files import read_text
from gaussray.prepare.calibrations.known_camera import (
    Calibration,
    KnownCamera,
    check_name,
    opencv_camera,
)
from gaussray.prepare.calibrations.opencv_numbers import (
    DISTORTION_COUNTS,
    checked_rotation,
    finite_numbers,
)
from gaussray.prepare.errors import PrepareError


# The names of both files in each layout, with the camera's name as a group.
_LENSES = (re.compile(r"(.+)_intrinsics\.dat", re.I), re.compile(r"(c\d+)\.dat", re.I))
_POSES = (re.compile(r"(.+)_rot_trans\.dat", re.I), re.compile(r"rot_trans_(c\d+)\.dat", re.I))
# What stands before a camera's name where its pose is from another world than the first camera.
_WORLD = "world_to_"
_REMEDY = (
    "Each camera needs a file with the lines intrinsic: (3 x 3 numbers) and distortion:, and one "
    "with R: (3 x 3) and T: (3), from world to camera: camera0_intrinsics.dat and "
    "camera0_rot_trans.dat, or c0.dat and rot_trans_c0.dat."
)


class _Files(NamedTuple):
    """The files of one layout in a folder, by the camera's name."""

    lenses: dict[str, Path]
    poses: dict[str, Path]
    world_poses: dict[str, Path]


def camera_dats(folder: Path) -> list[Path]:
    """The first file of lenses of each layout in a folder that has poses too."""
    layouts = [_files(folder, k) for k in range(len(_LENSES))]
    return [next(iter(own.lenses.values())) for own in layouts if own.lenses and _posed(own)]


def read_camera_dats(path: Path) -> Calibration:
    """The cameras of all files of a layout in the folder of one of them.

    A camera without a file of its pose is left out. The files `world_to_..._rot_trans.dat` are
    read if one of them is given, or if there are no others.

    Args:
        path: one of the files.

    Raises:
        PrepareError: The name is of neither layout, fewer than two cameras have both files, or a
            file lacks numbers.
    """
    layout = next(
        (k for k in range(len(_LENSES)) for pattern in (_LENSES[k], _POSES[k])
         if pattern.fullmatch(path.name)), None
    )  # fmt: skip
    if layout is None:
        raise PrepareError(
            f"{path}: a .dat file must have the name of a camera's lens or pose. {_REMEDY}"
        )
    files = _files(path.parent, layout)
    poses = files.world_poses if path.name.lower().startswith(_WORLD) else _posed(files)
    both = [name for name in files.lenses if name in poses]
    if len(both) < 2:
        names = ", ".join(p.name for p in [*files.lenses.values(), *poses.values()][:9])
        raise PrepareError(
            f"{path.parent}: must hold the lenses and poses of two cameras or more, got {names}. "
            f"{_REMEDY}"
        )
    left_out = {name: "has no file of R and T" for name in files.lenses if name not in poses}
    return Calibration([_camera(name, files.lenses[name], poses[name]) for name in both], left_out)


def _files(folder: Path, layout: int) -> _Files:
    names = sorted((p for p in folder.iterdir() if p.is_file()), key=lambda p: _order(p.name))
    result = _Files({}, {}, {})
    for path in names:
        if match := _LENSES[layout].fullmatch(path.name):
            result.lenses[match[1].lower()] = path
        elif match := _POSES[layout].fullmatch(path.name):
            name = match[1].lower()
            if name.startswith(_WORLD):
                result.world_poses[name.removeprefix(_WORLD)] = path
            else:
                result.poses[name] = path
    return result


def _posed(files: _Files) -> dict[str, Path]:
    return files.poses or files.world_poses


def _order(name: str) -> list[str]:
    """Sorts names by the numbers in them."""
    return [part.zfill(20) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


def _camera(name: str, lens: Path, pose: Path) -> KnownCamera:
    inner, outer = _sections(lens), _sections(pose)

    def numbers(path: Path, key: str, *counts: int) -> np.ndarray:
        content = inner if path == lens else outer
        try:
            if key not in content:
                raise ValueError(f"is missing, got {', '.join(content) or 'nothing'}")
            found = finite_numbers(content[key], counts)
            return checked_rotation(found) if key == "r" else found
        except ValueError as error:
            shown = key.upper() if len(key) == 1 else key
            raise PrepareError(f"{path}: {shown}: {error}. {_REMEDY}") from None

    matrix = numbers(lens, "intrinsic", 9).reshape(3, 3)
    distortion = numbers(lens, "distortion", *DISTORTION_COUNTS)
    columns = np.column_stack([numbers(pose, "r", 9), numbers(pose, "t", 3)])
    return opencv_camera(lens, check_name(lens, name), matrix, distortion, columns)


def _sections(path: Path) -> dict[str, list[float]]:
    """The numbers behind each line that ends with a colon, by what it says in small letters; of
    those that say the same the first, if a remark (a line that begins with #) is between them."""
    result: dict[str, list[float]] = {}
    own: list[float] = []
    remarked = False
    for count, line in enumerate(read_text(path).decode("utf-8-sig", "replace").splitlines(), 1):
        text = line.strip()
        if text.startswith("#"):
            remarked = True
            continue
        if text.endswith(":"):
            key = text[:-1].strip().lower()
            own = [] if remarked and key in result else result.setdefault(key, [])
            continue
        try:
            own += [float(word) for word in re.sub(r"[\[\],;]", " ", text).split()]
        except ValueError:
            raise PrepareError(
                f"{path}: line {count} must be numbers, got {text[:80]!r}. {_REMEDY}"
            ) from None
    return result
