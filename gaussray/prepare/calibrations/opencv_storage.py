"""Stereo calibrations in files of cv::FileStorage, as OpenCV's sample stereo_calib writes them.

The sample writes M1, D1, M2 and D2 to intrinsics.yml, and R and T to extrinsics.yml. One file may
hold all of them.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.io.safe.files import opened, parse_xml, read_text
from gaussray.prepare.calibrations.known_camera import ALL_KINDS, Calibration
from gaussray.prepare.calibrations.opencv_json import is_opencv_camera, refuse_single_camera
from gaussray.prepare.calibrations.opencv_yaml import read_opencv_yaml
from gaussray.prepare.calibrations.stereo_pair import (
    has_stereo_lenses,
    has_stereo_pose,
    stereo_cameras,
)
from gaussray.prepare.errors import PrepareError


_SUFFIXES = (".yml", ".yaml", ".xml")
# First bytes of a file in which the marks of cv::FileStorage are sought.
_HEAD = 4096
_MARKS = (b"<opencv_storage", b"!!opencv-matrix", b"!!opencv-nd-matrix", b"%YAML:")
# A file of a folder that is larger is no calibration (pictures, points).
_LARGEST = 1_000_000
_REMEDY = (
    "Write a file for each camera with CameraMatrix, DistortionCoeffs, RotationValues and "
    "TranslationValues (world to camera), or M1, D1, M2, D2, R and T of a stereo calibration. "
    f"{ALL_KINDS}"
)


def is_storage(path: Path) -> bool:
    """Whether a YAML or XML file was written by cv::FileStorage."""
    if path.suffix.lower() not in _SUFFIXES:
        return False
    with opened(path) as file:
        head = file.read(_HEAD)
    return any(mark in head for mark in _MARKS)


def is_small_storage(path: Path) -> bool:
    """Whether a file was written by cv::FileStorage and is not too large for a calibration."""
    if path.suffix.lower() not in _SUFFIXES or not path.is_file():
        return False
    return path.stat().st_size <= _LARGEST and is_storage(path)


def is_stereo_storage(*paths: Path) -> bool:
    """Whether files of cv::FileStorage hold together what a stereo calibration has."""
    try:
        if not all(is_storage(path) for path in paths):
            return False
        keys = {key for path in paths for key in storage_values(path)}
    except (PrepareError, OSError, ValueError):
        return False
    return has_stereo_lenses(keys) and has_stereo_pose(keys)


def stereo_storages(folder: Path) -> list[Path]:
    """One file of each stereo calibration in a folder: it holds all values, or those of the lenses
    with the poses in the file beside it (`read_stereo_storage`)."""
    small = [path for path in sorted(folder.iterdir()) if is_small_storage(path)]
    whole = [path for path in small if is_stereo_storage(path)]
    pairs = [(path, _counterpart(path)) for path in small if path not in whole]
    return whole + [
        one
        for one, two in pairs
        if two is not None and two not in whole and "intri" in one.name.lower()
        if is_stereo_storage(one, two)
    ]


def read_stereo_storage(path: Path) -> Calibration:
    """The two cameras of a file, and of the one beside it whose name has `extri` for `intri`, or
    the reverse, if the file alone has lenses or poses only.

    Raises:
        PrepareError: The file is malformed, is of one camera, has keys of other meaning, or a value
            is missing.
    """
    values, where = storage_values(path), str(path)
    lenses, poses = has_stereo_lenses(values), has_stereo_pose(values)
    if not lenses and is_opencv_camera(values):
        refuse_single_camera(path)
    if not lenses and not poses:
        found = ", ".join(map(str, values))[:200] or "no keys"
        raise PrepareError(
            f"{path}: must be a file of OpenCV's FileStorage with the keys of a calibration, got "
            f"{found}. {_REMEDY}"
        )
    beside = _other_name(path.name)
    if not (lenses and poses) and beside is not None:
        other = _counterpart(path)
        if other is None:
            missing = "R and T" if lenses else "M1, D1, M2 and D2"
            raise PrepareError(
                f"{path}: must hold all of {missing}, or {beside} must be beside it with them, got "
                f"{', '.join(values)[:200]}. Copy it there, or write all into one file."
            )
        values, where = {**storage_values(other), **values}, f"{path} with {other.name}"
    return stereo_cameras(where, values, name=path.name)


def _other_name(name: str) -> str | None:
    """The name of the file of poses beside that of lenses, or the reverse; None if it has none."""
    match = re.search("(intri|extri)", name, re.IGNORECASE)
    if match is None:
        return None
    swapped = {"in": "ex", "ex": "in", "In": "Ex", "Ex": "In", "IN": "EX", "EX": "IN"}
    start = match.start()
    return name[:start] + swapped.get(name[start : start + 2], "ex") + name[start + 2 :]


def _counterpart(path: Path) -> Path | None:
    """The file beside another that has the rest of a calibration, whatever its case and suffix."""
    name = _other_name(path.name)
    if name is None:
        return None
    stem = Path(name).stem.lower()
    files = [p for p in sorted(path.parent.iterdir()) if p.stem.lower() == stem and p.is_file()]
    found = [p for p in files if is_storage(p)]
    return next((p for p in found if p.suffix == path.suffix), found[0] if found else None)


def storage_values(path: Path) -> dict[str, Any]:
    """The values by key of a YAML or XML file that cv::FileStorage has written.

    Raises:
        PrepareError: The file is malformed.
    """
    if path.suffix.lower() != ".xml":
        return read_opencv_yaml(path, _REMEDY)
    try:
        root = parse_xml(path, read_text(path))
    except ValueError as error:
        raise PrepareError(f"{error} {_REMEDY}") from None
    values: dict[str, Any] = {}
    for node in root:
        if node.find("data") is not None:
            text = node.findtext("data") or ""
            sizes = [node.findtext(key) or "" for key in ("rows", "cols")]
        else:
            text, sizes = node.text or "", []
        try:
            numbers = np.array(text.replace(".Nan", "nan").split(), np.float64)
            shape = [int(size) for size in sizes] or [-1]
            values[node.tag] = numbers.reshape(shape) if numbers.size else text.strip()
        except ValueError:
            # A text, or a matrix that has not all of its numbers: told where it is needed.
            values[node.tag] = " ".join(text.split())
    return values
