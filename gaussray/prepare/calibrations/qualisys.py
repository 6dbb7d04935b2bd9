"""Qualisys calibrations: .qca.txt and .xml files, as Qualisys Track Manager and Pose2Sim write."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from gaussray.io.safe.files import parse_xml, read_text
from gaussray.prepare.calibrations.known_camera import (
    KnownCamera,
    check_name,
    opencv_camera,
)
from gaussray.prepare.errors import PrepareError


# Intrinsics are in 64ths of a pixel, translations in millimetres.
_SUBPIXELS, _MILLIMETRES = 64.0, 1000.0
_REMEDY = "Export the calibration from Qualisys Track Manager again."


def read_qualisys(path: Path) -> list[KnownCamera]:
    """The cameras of a Qualisys file.

    The nine numbers of the rotation, row by row, take world to camera axes, which a half turn about
    x takes to OpenCV's; the translation is the camera's place in the world.

    Raises:
        PrepareError: The file is no XML of cameras, or a camera lacks a number.
    """
    text = read_text(path)
    try:
        root = parse_xml(path, text)
    except ValueError as error:
        raise PrepareError(f"{error} {_REMEDY}") from None
    nodes = [n for n in root.findall("cameras/camera") if n.find("intrinsic") is not None]
    if not nodes:
        raise PrepareError(
            f"{path}: must list cameras with intrinsics, as Qualisys writes them, got none. "
            f"{_REMEDY} Of Metashape, export the cameras (not the lens alone)."
        )
    return [_camera(path, node) for node in nodes]


def _camera(path: Path, node: ElementTree.Element) -> KnownCamera:
    name = check_name(path, node.get("serial"))

    def numbers(child: str, keys: str) -> np.ndarray:
        element = node.find(child)
        try:
            if element is None:
                raise KeyError(child)
            return np.array([float(element.attrib[key]) for key in keys.split()])
        except (KeyError, ValueError) as error:
            raise PrepareError(
                f"{path}: camera {name} must have {child} with {keys}, got {error}. {_REMEDY}"
            ) from None

    left, top, right, bottom = numbers("fov_video", "left top right bottom")
    inner = numbers("intrinsic", "focalLengthU focalLengthV centerPointU centerPointV") / _SUBPIXELS
    distortion = numbers(
        "intrinsic",
        "radialDistortion1 radialDistortion2 tangentalDistortion1 tangentalDistortion2",
    )
    if node.find("intrinsic[@radialDistortion3]") is not None:
        distortion = np.append(distortion, numbers("intrinsic", "radialDistortion3"))
    matrix = np.array([[inner[0], 0, inner[2] - left], [0, inner[1], inner[3] - top], [0, 0, 1]])
    turn = numbers("transform", "r11 r12 r13 r21 r22 r23 r31 r32 r33").reshape(3, 3)
    position = numbers("transform", "x y z") / _MILLIMETRES
    flip = np.diag([1.0, -1.0, -1.0])
    rotation = flip @ turn
    pose = np.column_stack([rotation, -rotation @ position])
    size = int(right - left) + 1, int(bottom - top) + 1
    return opencv_camera(path, name, matrix, distortion, pose, size)
