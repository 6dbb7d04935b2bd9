"""Reads the lens of one camera, or those of several by their names, from a file without poses."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.kitti import has_kitti_projections, kitti_matrices
from gaussray.capture.formats.transforms import json_content
from gaussray.io.safe.arrays import Damaged, read_npz
from gaussray.io.safe.files import read_text
from gaussray.prepare.calibrations.camera_values import has_matrix, tell_few_coefficients
from gaussray.prepare.calibrations.known_camera import check_name, opencv_camera
from gaussray.prepare.calibrations.lens_values import camera_of_values
from gaussray.prepare.calibrations.listed_values import NAMES_REMEDY
from gaussray.prepare.calibrations.named_cameras import named_cameras, whole_camera
from gaussray.prepare.calibrations.nerfstudio import frame_lens, read_nerfstudio
from gaussray.prepare.calibrations.opencv_storage import is_storage, storage_values
from gaussray.prepare.calibrations.opencv_yaml import read_opencv_yaml
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.calibrations.tsai import is_tsai, read_tsai, tell_tsai
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.lens_models import LensKeyValues


_KINDS = (
    "OpenCV's .yml, .xml or .npz with camera_matrix and distortion_coefficients (also mtx and "
    "dist, K and D), ROS's camera_info .yaml, EuRoC's sensor.yaml, Kalibr's camchain.yaml, "
    "Pose2Sim's or Anipose's .toml, KITTI's calib.txt, .json with K and dist or with fl_x fl_y cx "
    "cy k1 ... w h, or the numbers themselves: poses.lens=[fx,fy,cx,cy,k1,k2,p1,p2]"
)
# Keys of a capture's JSON that say a lens at the top of the file.
_CAPTURE = ("fl_x", "camera_angle_x")


def read_lenses(path: Path | str) -> dict[str, LensKeyValues]:
    """The lens of each camera of a file by the camera's name; that of a file that names none is
    called as the file.

    Args:
        path: a file of one camera's lens, or a calibration (`read_calibration`), whose poses do not
            count.

    Raises:
        FileNotFoundError: There is no such file.
        PrepareError: It holds no lens, or one that is not supported.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"poses.lens={path}: must be a file, got {'a folder' if path.is_dir() else 'none'}. "
            "Check the path, and name the file itself."
        )
    if is_tsai(path):
        camera = read_tsai(path, path.stem)
        tell_tsai(path, {path.stem: camera})
        return {path.stem: camera.camera.lens}
    if has_kitti_projections(path):
        return {
            name: opencv_camera(path, name, matrix, np.zeros(0), np.eye(3, 4)).lens
            for name, matrix in kitti_matrices(path).items()
        }
    content = _content(path)
    found = _lenses(path, content) if isinstance(content, Mapping | list) else {}
    return found or _calibrated_lenses(path)


def _content(path: Path) -> Any:
    """What a file holds; None if it is of a kind that other readers know."""
    suffix = path.suffix.lower()
    if suffix in (".yml", ".yaml"):
        return read_opencv_yaml(path, f"It may be {_KINDS}.")
    if suffix == ".xml" and is_storage(path):
        return storage_values(path)
    if suffix == ".json":
        return json_content(path)
    try:
        if suffix == ".npz":
            return read_npz(path)
        if suffix == ".toml":
            content = tomllib.loads(read_text(path).decode("utf-8-sig"))
            return content if "cameras" in content else _named_tables(content)
    except (Damaged, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PrepareError(f"poses.lens={path}: {error}. It may be {_KINDS}.") from None
    return None


def _named_tables(content: dict[str, Any]) -> dict[str, Any]:
    """The tables of a TOML file as a list of cameras, which have the names that they say."""
    tables = {key: one for key, one in content.items() if isinstance(one, dict)}
    cameras = [{"name": key, **one} for key, one in tables.items()]
    return {key: one for key, one in content.items() if key not in tables} | {"cameras": cameras}


def _lenses(path: Path, content: Mapping[str, Any] | list) -> dict[str, LensKeyValues]:
    """The lenses of what a file holds: of one camera at the top, or of several; empty if none."""
    if isinstance(content, Mapping):
        if isinstance(content.get("frames"), list):
            return {camera.name: camera.lens for camera in read_nerfstudio(path)}
        if any(key in content for key in _CAPTURE):
            return {path.stem: frame_lens(Keys(path, dict(content)))}
        camera = whole_camera(path, content)
        if camera is not None and has_matrix(camera):
            lens = camera_of_values(path, path.name, camera).lens
            tell_few_coefficients(path, [camera])
            return {path.stem: lens}
    cameras = named_cameras(path, content)
    lenses = {
        check_name(path, name): camera_of_values(path, name, one).lens
        for name, one in cameras.items()
    }
    tell_few_coefficients(path, cameras.values())
    return lenses


def _calibrated_lenses(path: Path) -> dict[str, LensKeyValues]:
    """The lenses of a calibration with poses."""
    try:
        calibration = read_calibration(path)
    except PrepareError as error:
        raise PrepareError(
            f"poses.lens={path}: must hold the lens of a camera, got none that is read. It may be "
            f"{_KINDS}. As a calibration it is not read either: {error}"
        ) from None
    if calibration.in_order:
        raise PrepareError(
            f"poses.lens={path}: must name its cameras, got {len(calibration.cameras)} without "
            f"names. To mend it, {NAMES_REMEDY}."
        )
    return {camera.name: camera.lens for camera in calibration.cameras}
