"""Photographs with the cameras of AliceVision and Meshroom: `cameras.sfm` and other `.sfm` files.

Numbers are texts there. Keys changed their meaning with the file's version; the rules are those of
AliceVision's `sfmDataIO`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike, Float

from gaussray.capture.capture import Capture
from gaussray.capture.formats.json_keys import Keys, block_in, listed_blocks
from gaussray.capture.formats.project_files import fullest_project, projects_in, warn_of_projects
from gaussray.capture.formats.sfm_points import given_points
from gaussray.capture.formats.sfm_project import (
    FIRST_PIXEL,
    LENS_TYPES,
    LensType,
    Photograph,
    lens_remedy,
    project_capture,
    rotation_in,
)
from gaussray.capture.formats.transforms import json_object


# Where projects are, in a capture's folder, and what their heads have.
SFM_FILES = ("*.sfm", "MeshroomCache/StructureFromMotion/*/*.sfm")
_HEAD = rb'^\s*\{[^{]*"version"'
# Names of results of structure from motion.
_RESULTS = ("sfm.sfm", "cameras.sfm")
_REMEDY = lens_remedy("Meshroom", "aliceVision_exportColmap")
# Names of distortions since version 1.2.8; before, they were types of a camera (LENS_TYPES).
_DISTORTIONS = {
    "none": LENS_TYPES["pinhole"],
    "radialk1": LENS_TYPES["radial1"],
    "radialk3": LENS_TYPES["radial3"],
    "brown": LENS_TYPES["brown"],
    "fisheye": LENS_TYPES["fisheye4"],
}
_Version = tuple[int, ...]
_Pose = tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]


class _Project(NamedTuple):
    """Lenses, poses and rigs by their numbers."""

    version: _Version
    lenses: Mapping[str, Keys]
    poses: Mapping[str, Keys]
    rigs: Mapping[str, Keys]


def alicevision_file(folder: Path) -> Path | None:
    """The project of AliceVision in a folder, or in its MeshroomCache; None if there is none.

    Of several it is one with the name of a result of structure from motion (`sfm.sfm`,
    `cameras.sfm`), then the one with most poses, then the one with points.
    """
    return fullest_project(projects_in(folder, SFM_FILES, _HEAD), _rank)


def read_alicevision(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The photographs of a project of AliceVision or Meshroom, as a still scene.

    World, poses and points are the file's. Views without pose are left out with a warning; none is
    held out. Lens types: pinhole, radial1, radial3, brown and fisheye4.

    Args:
        folder: the folder with the file, or that of a Meshroom project with its MeshroomCache; the
            pictures are in it or in its folders.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format, or has another lens type; the message names
            file, view and key.
        FileNotFoundError: there is no such file.
    """
    folder = Path(folder)
    projects = projects_in(folder, SFM_FILES, _HEAD)
    path = fullest_project(projects, _rank)
    if path is None:
        raise FileNotFoundError(f"{folder}: holds no project of AliceVision ({SFM_FILES[0]}).")
    top = Keys(path, json_object(path))
    warn_of_projects(top, projects)
    lists = (("intrinsics", "intrinsicId"), ("poses", "poseId"), ("rigs", "rigId"))
    project = _Project(_version(top), *(_by_number(top, *names) for names in lists))
    views = listed_blocks(top, "views", "view")
    listed = [_photograph(view, project) for view in views]
    points = listed_blocks(top, "structure", "point")
    positions = [point.values.get("X") for point in points]
    colors = [point.values.get("color") for point in points]
    given = given_points(top, "structure", positions, colors)
    return project_capture(folder, top, listed, given, dtype)


def _rank(path: Path, content: Mapping) -> tuple[int, ...]:
    poses = content.get("poses")
    count = len(poses) if isinstance(poses, list) else 0
    return bool(count and path.name in _RESULTS), count, bool(content.get("structure"))


def _version(top: Keys) -> _Version:
    """The version of the file, three whole numbers."""
    numbers = _plain(top.values.get("version"))
    good = isinstance(numbers, list) and len(numbers) == 3
    if not good or not all(isinstance(x, float) and x.is_integer() for x in numbers):
        raise top.error("version", "three whole numbers")
    return tuple(int(x) for x in numbers)


def _plain(value: Any) -> Any:
    """A value with numbers in place of the texts that are numbers."""
    if isinstance(value, list):
        return [_plain(one) for one in value]
    if isinstance(value, bool):
        return value
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return value
    # What is not finite is none: messages show the text.
    return number if np.isfinite(number) else value


def _numbers(keys: Keys) -> Keys:
    plain = {key: _plain(value) for key, value in keys.values.items()}
    return Keys(keys.file, plain, keys.frame, keys.prefix, keys.kind)


def _by_number(top: Keys, name: str, number: str) -> dict[str, Keys]:
    blocks = listed_blocks(top, name, name.removesuffix("s"))
    return {str(block.values.get(number)): block for block in blocks}


def _photograph(view: Keys, project: _Project) -> Photograph | None:
    """A view with its camera; None if it has no pose."""
    pose = _view_pose(view, project)
    if pose is None:
        return None
    path, number = view.text("path"), str(view.values.get("intrinsicId"))
    if number not in project.lenses:
        raise view.error("intrinsicId", "that of one of the intrinsics")
    turn, place = pose
    prefix = f"lens of {path}: "
    lens = Keys(view.file, project.lenses[number].values, view.frame, prefix, "view")
    return Photograph(path, _lens(_numbers(lens), project.version), turn, place.tolist())


def _view_pose(view: Keys, project: _Project) -> _Pose | None:
    """Where a view is from: its pose, or that of its rig with its own in the rig."""
    pose = project.poses.get(str(view.values.get("poseId")))
    if pose is None:
        return None
    turn, place = _pose(block_in(pose, "pose", "transform"))
    apart = str(view.values.get("isPoseIndependant", "true")).lower() in ("true", "1")
    if apart or not view.has("rigId"):
        return turn, place
    rig = project.rigs.get(str(view.values["rigId"]))
    if rig is None:
        raise view.error("rigId", "that of one of the rigs")
    inner = listed_blocks(rig, "subPoses", "pose of a rig")
    index = _numbers(view).count("subPoseId", least=0)
    if index >= len(inner):
        raise view.error("subPoseId", f"below the {len(inner)} poses of its rig")
    if str(inner[index].values.get("status")).lower() == "uninitialized":
        return None
    inner_turn, inner_place = _pose(block_in(inner[index], "pose"))
    return turn @ inner_turn, place + turn @ inner_place


def _pose(block: Keys) -> _Pose:
    """Rotation, camera to world, and place. The file has the rotation to the camera column by
    column, which is its inverse row by row."""
    keys = _numbers(block)
    turn = rotation_in(keys, "rotation", keys.vector("rotation", 9))
    return turn, np.array(keys.vector("center", 3))


def _lens(keys: Keys, version: _Version) -> dict[str, Any]:
    """The keys of a lens, as in a transforms.json."""
    kind = _lens_type(keys, version)
    size = np.array([keys.count("width"), keys.count("height")])
    center = np.array(keys.vector("principalPoint", 2))
    if version >= (1, 2, 1):
        center += size / 2
    (fl_x, fl_y), (cx, cy) = _focal(keys, version, size), (center + FIRST_PIXEL).tolist()
    if not (0 < fl_x < np.inf and 0 < fl_y < np.inf):
        raise keys.error("focalLength" if version >= (1, 2, 2) else "pxFocalLength", "above 0")
    return {
        **{"camera_model": kind.camera_model, "w": int(size[0]), "h": int(size[1])},
        **{"fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy},
        **dict(zip(kind.coefficients, _coefficients(keys, len(kind.coefficients)), strict=True)),
    }


def _coefficients(keys: Keys, count: int) -> list[float]:
    """The coefficients of a lens; all are 0 if the file has none."""
    given = keys.values.get("distortionParams")
    if not given:
        return [0.0] * count
    if count:
        return keys.vector("distortionParams", count)
    if not isinstance(given, list) or any(isinstance(x, bool) or x != 0 for x in given):
        raise keys.error("distortionParams", "zeros or absent, as the lens has no distortion")
    return []


def _lens_type(keys: Keys, version: _Version) -> LensType:
    """The type of a lens; those that differ from all here are refused."""

    def chosen(key: str, choices: Mapping[str, LensType]) -> LensType:
        kind = keys.text(key).lower()
        if kind not in choices:
            raise keys.error(key, f"one of {', '.join(choices)}", _REMEDY)
        return choices[kind]

    if version < (1, 2, 8):
        return chosen("type", LENS_TYPES)
    chosen("type", {"pinhole": LENS_TYPES["pinhole"]})
    if keys.has("undistortionType"):
        chosen("undistortionType", {"none": LENS_TYPES["pinhole"]})
    return chosen("distortionType", _DISTORTIONS)


def _focal(keys: Keys, version: _Version, size: np.ndarray) -> tuple[float, float]:
    """The focal lengths along x and y, in pixels."""
    if version < (1, 2, 0):
        focal = keys.number("pxFocalLength")
        return focal, focal
    if version < (1, 2, 2):
        fl_x, fl_y = keys.vector("pxFocalLength", 2)
        return fl_x, fl_y
    width, shape = keys.number("sensorWidth"), keys.number("pixelRatio", 1.0)
    if not (width > 0 and shape > 0):
        raise keys.error("sensorWidth" if shape > 0 else "pixelRatio", "above 0")
    # Until 1.2.10 the width of the sensor is that of the picture, then that of its longer side.
    # The length is that along x until then, of which the ratio was y / x, at first x / y.
    side = int(max(size) if version >= (1, 2, 11) else size[0])
    focal = keys.number("focalLength") * side / width
    if version < (1, 2, 5):
        return focal, focal / shape
    return (focal, focal * shape) if version < (1, 2, 11) else (focal / shape, focal)
