"""Photographs with the cameras of OpenMVG: `sfm_data.json`."""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

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
SFM_DATA_FILES = ("sfm_data.json", "*/sfm_data.json")
_HEAD = rb'^\s*\{[^{]*"sfm_data_version"'
_REMEDY = lens_remedy("OpenMVG", "openMVG_main_openMVG2Colmap")
# Types by their names, and where they have their coefficients.
_SPHERE = "spherical"
_TYPES: dict[str, tuple[LensType, str]] = {
    "pinhole": (LENS_TYPES["pinhole"], ""),
    "pinhole_radial_k1": (LENS_TYPES["radial1"], "disto_k1"),
    "pinhole_radial_k3": (LENS_TYPES["radial3"], "disto_k3"),
    "pinhole_brown_t2": (LENS_TYPES["brown"], "disto_t2"),
    "fisheye": (LENS_TYPES["fisheye4"], "fisheye"),
    _SPHERE: (LensType("EQUIRECTANGULAR"), ""),
}
# Of the number of a type: set where it occurs for the first time, with its name.
_FIRST = 0x80000000


def openmvg_file(folder: Path) -> Path | None:
    """The project of OpenMVG in a folder, or in a folder of it; None if there is none. Of several
    it is the one with most poses."""
    return fullest_project(projects_in(folder, SFM_DATA_FILES, _HEAD), _rank)


def read_openmvg(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The photographs of a project of OpenMVG, as a still scene.

    World, poses and points (which have no colours) are the file's. Views without pose are left out
    with a warning; none is held out. Types: pinhole, pinhole_radial_k1, pinhole_radial_k3,
    pinhole_brown_t2, fisheye and spherical.

    Args:
        folder: the folder with the file, or one around it; the pictures are in it or its folders.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format, or has another type of camera; the message
            names file, view and key.
        FileNotFoundError: there is no such file.
    """
    folder = Path(folder)
    projects = projects_in(folder, SFM_DATA_FILES, _HEAD)
    path = fullest_project(projects, _rank)
    if path is None:
        raise FileNotFoundError(f"{folder}: holds no {SFM_DATA_FILES[0]} of OpenMVG.")
    top = Keys(path, json_object(path))
    warn_of_projects(top, projects)
    views = [block_in(view, "value") for view in listed_blocks(top, "views", "view")]
    lenses, poses = dict(_by_key(top, "intrinsics")), dict(_by_key(top, "extrinsics"))
    names = _type_names([*views, *lenses.values()])
    root = top.values.get("root_path")
    root = root if isinstance(root, str) else ""
    listed = [_photograph(_data(view), root, (lenses, poses, names)) for view in views]
    positions = [block.values.get("X") for _, block in _by_key(top, "structure")]
    points = given_points(top, "structure", positions, None)
    return project_capture(folder, top, listed, points, dtype)


def _rank(path: Path, content: Mapping) -> tuple[int, ...]:
    poses = content.get("extrinsics")
    return (len(poses) if isinstance(poses, list) else 0,)


def _by_key(top: Keys, name: str) -> list[tuple[str, Keys]]:
    """The blocks of a map, which is a list of keys and values."""
    blocks = listed_blocks(top, name, f"entry of {name}")
    return [(str(block.values.get("key")), block_in(block, "value")) for block in blocks]


def _type_names(blocks: Iterable[Keys]) -> dict[Any, str]:
    """Names of types by their numbers, which only the first block of each type tells."""
    return {
        _type_number(block): name
        for block in blocks
        if isinstance(name := block.values.get("polymorphic_name"), str)
    }


def _type_number(block: Keys) -> int | None:
    number = block.values.get("polymorphic_id")
    return number & (_FIRST - 1) if isinstance(number, int) else None


def _data(block: Keys) -> Keys:
    """What a block of a type holds, with what it inherits (`value0`)."""
    data = block_in(block, "ptr_wrapper", "data")
    values = dict(data.values)
    while isinstance(values.get("value0"), dict):
        values = values.pop("value0") | values
    return Keys(data.file, values, data.frame, kind=data.kind)


def _photograph(
    view: Keys,
    root: str,
    tables: tuple[Mapping[str, Keys], Mapping[str, Keys], Mapping[Any, str]],
) -> Photograph | None:
    """A view with its camera; None if it has no pose. The file has the rotation to the camera."""
    lenses, poses, names = tables
    number, pose = str(view.values.get("id_intrinsic")), poses.get(str(view.values.get("id_pose")))
    if pose is None:
        return None
    inner = view.values.get("local_path")
    name = view.text("filename")
    if number not in lenses:
        raise view.error("id_intrinsic", "the key of one of the intrinsics")
    parts = (root, inner if isinstance(inner, str) else "", name)
    path = "/".join(part.rstrip("/") if k else part for k, part in enumerate(parts) if part)
    block, data = lenses[number], _data(lenses[number])
    kind = block.values.get("polymorphic_name") or names.get(_type_number(block))
    values = {**data.values, "polymorphic_name": kind}
    lens = Keys(view.file, values, view.frame, f"lens of {name}: ", view.kind)
    turn = rotation_in(pose, "rotation", _rows(pose)).T
    return Photograph(path, _lens(lens), turn, pose.vector("center", 3))


def _rows(pose: Keys) -> list[float]:
    """The nine numbers of a rotation."""
    rows = pose.values.get("rotation")
    if not isinstance(rows, list) or len(rows) != 3:
        raise pose.error("rotation", "three rows of three finite numbers")
    numbered = [dataclasses.replace(pose, values={"rotation": row}) for row in rows]
    return [x for row in numbered for x in row.vector("rotation", 3)]


def _lens(keys: Keys) -> dict[str, Any]:
    """The keys of a lens, as in a transforms.json."""
    kind = keys.values.get("polymorphic_name")
    if not isinstance(kind, str) or kind not in _TYPES:
        raise keys.error("polymorphic_name", f"one of {', '.join(_TYPES)}", _REMEDY)
    (model, coefficients), key = _TYPES[kind]
    size = np.array([keys.count("width"), keys.count("height")])
    lens = {"camera_model": model, "w": int(size[0]), "h": int(size[1])}
    if kind == _SPHERE:
        # Half a pixel further, its border would show more than the sphere.
        focal, center = float(max(size)) / 2, size / 2
    else:
        focal = keys.number("focal_length")
        center = np.array(keys.vector("principal_point", 2)) + FIRST_PIXEL
    if not focal > 0:
        raise keys.error("focal_length", "above 0")
    cx, cy = center.tolist()
    values = keys.vector(key, len(coefficients)) if key else []
    return {
        **{**lens, "fl_x": focal, "fl_y": focal, "cx": cx, "cy": cy},
        **dict(zip(coefficients, values, strict=True)),
    }
