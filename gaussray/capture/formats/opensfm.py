"""Photographs with the cameras of OpenSfM, which OpenDroneMap uses too: `reconstruction.json`.

Lengths in pictures are in units of the longer side, from the middle; the formulas are those of
OpenSfM's documentation ("Geometric models").
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys, block_in
from gaussray.capture.formats.poses import axis_angle_turn
from gaussray.capture.formats.project_files import begins_with
from gaussray.capture.formats.sfm_points import given_points
from gaussray.capture.formats.sfm_project import LensType, Photograph, lens_remedy, project_capture
from gaussray.capture.formats.transforms import json_content
from gaussray.io.safe.files import opened


# Where the file is, in a capture's folder: OpenDroneMap's projects have it in a folder of its own.
RECONSTRUCTION_FILES = ("reconstruction.json", "opensfm/reconstruction.json")
# What each reconstruction has, at the least.
_HOLDS = (rb'"cameras"\s*:', rb'"shots"\s*:')
# Bytes that are searched at once, and those that a key may take.
_AT_ONCE, _LONGEST_KEY = 1_000_000, 100
_IMAGES = "images"
_REMEDY = lens_remedy("OpenSfM (`bin/opensfm undistort`)", "bin/opensfm export_colmap")
# Types with one focal length and the axis in the middle, with two and an axis, and spheres.
_CENTRED = {
    "perspective": LensType("OPENCV", ("k1", "k2")),
    "fisheye": LensType("OPENCV_FISHEYE", ("k1", "k2")),
}
_LENSES = {
    "simple_radial": LensType("OPENCV", ("k1",)),
    "radial": LensType("OPENCV", ("k1", "k2")),
    "brown": LensType("OPENCV", ("k1", "k2", "k3", "p1", "p2")),
    "fisheye_opencv": LensType("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
}
_SPHERES = ("spherical", "equirectangular")
# No rotation is by more radians, and no camera further away.
_WHOLE_TURNS, _FAR = 100.0, 1e30


def opensfm_file(folder: Path) -> Path | None:
    """The reconstructions of OpenSfM in a folder; None if there are none."""
    paths = (folder / name for name in RECONSTRUCTION_FILES)
    return next((path for path in paths if _is_reconstruction(path)), None)


def read_opensfm(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The photographs of the largest reconstruction of OpenSfM or OpenDroneMap, as a still scene.

    World, poses and points are the file's; none is held out. A warning counts the pictures of other
    reconstructions, which are left out. Types: perspective, simple_radial, radial, brown, fisheye,
    fisheye_opencv, spherical and equirectangular.

    Args:
        folder: the folder with the file, or that of a project of OpenDroneMap; the pictures are in
            `images/` or elsewhere in it.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format, or has another type of camera; the message
            names file, picture and key.
        FileNotFoundError: there is no such file.
    """
    folder = Path(folder)
    path = opensfm_file(folder)
    if path is None:
        raise FileNotFoundError(f"{folder}: holds no {RECONSTRUCTION_FILES[0]} of OpenSfM.")
    top = _largest(path, json_content(path))
    shots, cameras = block_in(top, "shots"), block_in(top, "cameras").values
    listed = [_photograph(block_in(shots, name), name, cameras) for name in shots.values]
    points = block_in(top, "points").values if top.has("points") else {}
    wrong = next((name for name, point in points.items() if not isinstance(point, dict)), None)
    if wrong is not None:
        raise Keys(path, points, prefix="points.").error(wrong, "a block of keys")
    positions = [point.get("coordinates") for point in points.values()]
    colors = [point.get("color") for point in points.values()]
    given = given_points(Keys(path, {}), "points", positions, colors)
    return project_capture(folder, Keys(path, {}), listed, given, dtype)


def _is_reconstruction(path: Path) -> bool:
    """Whether a file is a list of blocks with cameras and shots, which may come after many
    cameras."""
    if not begins_with(path, rb"^\s*\[\s*\{"):
        return False
    lacking, part = set(_HOLDS), b""
    with opened(path) as file:
        while lacking and (read := file.read(_AT_ONCE)):
            part = part[-_LONGEST_KEY:] + read
            lacking = {key for key in lacking if not re.search(key, part)}
    return not lacking


def _largest(path: Path, content: Any) -> Keys:
    """The reconstruction with most pictures."""
    if not isinstance(content, list) or not all(isinstance(some, dict) for some in content):
        raise CaptureError(f"{path}: must hold a list of reconstructions.")
    shots = [some.get("shots") for some in content]
    counts = [len(some) if isinstance(some, dict) else 0 for some in shots]
    largest = int(np.argmax(counts))
    others = [str(count) for k, count in enumerate(counts) if k != largest]
    if others:
        Keys(path, {}).warn(
            f"of {len(counts)} reconstructions the one with most pictures ({counts[largest]}) is "
            f"read. Those of the others ({', '.join(others)}) are left out: each has a world of "
            "its own."
        )
    return Keys(path, content[largest])


def _photograph(shot: Keys, name: str, cameras: Mapping[str, Any]) -> Photograph:
    """A shot with its camera. The file has the rotation and translation to the camera."""
    camera = shot.text("camera")
    if not isinstance(cameras.get(camera), dict):
        raise shot.error("camera", "the name of one of the cameras")
    keys = Keys(shot.file, cameras[camera], prefix=f"camera of {name}: ")
    rotation, translation = shot.vector("rotation", 3), shot.vector("translation", 3)
    # Larger numbers are no angles, and overflow.
    if max(map(abs, rotation)) > _WHOLE_TURNS or max(map(abs, translation)) > _FAR:
        key = "translation" if max(map(abs, rotation)) <= _WHOLE_TURNS else "rotation"
        raise shot.error(key, "that of a camera", "Remove the picture.")
    turn = axis_angle_turn(rotation).T
    place = -turn @ translation
    return Photograph(f"{_IMAGES}/{name}", _lens(keys), turn, place.tolist())


def _lens(keys: Keys) -> dict[str, Any]:
    """The keys of a camera's lens, as in a transforms.json."""
    kinds = (*_CENTRED, *_LENSES, *_SPHERES)
    kind = keys.text("projection_type", "perspective")
    if kind not in kinds:
        raise keys.error("projection_type", f"one of {', '.join(kinds)}", _REMEDY)
    width, height = keys.count("width"), keys.count("height")
    longer = max(width, height)
    lens = {"w": width, "h": height, "cx": width / 2, "cy": height / 2}
    if kind in _SPHERES:
        return lens | {"camera_model": "EQUIRECTANGULAR", "fl_x": longer / 2, "fl_y": longer / 2}
    names = ("focal", "focal") if kind in _CENTRED else ("focal_x", "focal_y")
    focal = [keys.number(name) for name in names]
    for name, value in zip(names, focal, strict=True):
        if not value > 0:
            raise keys.error(name, "above 0")
    if kind in _LENSES:
        lens["cx"] += longer * keys.number("c_x", 0.0)
        lens["cy"] += longer * keys.number("c_y", 0.0)
    model, coefficients = (_CENTRED | _LENSES)[kind]
    return {
        **{**lens, "camera_model": model, "fl_x": longer * focal[0], "fl_y": longer * focal[1]},
        **{name: keys.number(name, 0.0) for name in coefficients},
    }
