"""Photographs with the cameras of Bundler (Snavely et al. 2006): `bundle.out` and `list.txt`."""

import codecs
import re
from array import array
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike, Float

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.project_files import projects_in, warn_of_projects
from gaussray.capture.formats.sfm_points import given_points
from gaussray.capture.formats.sfm_project import Photograph, project_capture, rotation_in
from gaussray.capture.picture_file import picture_exists
from gaussray.geometry import BLENDER_AXES
from gaussray.io.safe.files import read_text
from gaussray.io.safe.limits import within


# Where models are, in a capture's folder, and how they begin.
BUNDLE_FILES = ("bundle.out", "*/bundle.out")
_HEAD = rb"^# Bundle file v0\."
# The lists of pictures, from the folder of a model.
LIST_FILES = ("list.txt", "../list.txt", "../prepare/list.txt", "prepare/list.txt")
# Focal length, two coefficients, rotation row by row, and translation of a camera.
_CAMERA = 15
# Position and colour of a point; camera, key and place of each of its measurements.
_POINT, _MEASUREMENT = 6, 4
_NUMBER, _BLANK = re.compile(r"[-+0-9.eE]+"), re.compile(rb"\s")
# Bytes of a model that are read at once, about.
_PIECE = 1 << 20


def bundler_file(folder: Path) -> Path | None:
    """The model of Bundler in a folder, or in a folder of it; None if there is none."""
    return next(iter(projects_in(folder, BUNDLE_FILES, _HEAD)), None)


def read_bundler(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The photographs of a model of Bundler, as a still scene.

    World, poses and points are the file's. The axis of each lens meets the middle of its picture,
    whose size is that of its file. Cameras without a focal length were not registered, and are left
    out with a warning; none is held out.

    Args:
        folder: the folder with the model, or one around it; the pictures are in it or its folders.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a file contradicts the format; the message names it.
        FileNotFoundError: there is no model, no list of pictures, or none of these.
    """
    folder = Path(folder)
    projects = projects_in(folder, BUNDLE_FILES, _HEAD)
    if not projects:
        raise FileNotFoundError(f"{folder}: holds no {BUNDLE_FILES[0]} of Bundler.")
    top = Keys(projects[0], {})
    warn_of_projects(top, projects)
    cameras, positions, colors = _model(top)
    names = _names(top, len(cameras))
    _demand_pictures_inside(folder, top, [name for name, _ in names])
    listed = [
        _photograph(top, k, *name, numbers)
        for k, (name, numbers) in enumerate(zip(names, cameras, strict=True))
    ]
    points = given_points(top, "points", positions, colors)
    return project_capture(folder, top, listed, points, dtype)


def _model(
    top: Keys,
) -> tuple[Float[np.ndarray, "cameras 15"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """The numbers of each camera, and positions and colours of the points."""
    text = re.sub(rb"#.*", b"", read_text(top.file).removeprefix(codecs.BOM_UTF8))
    numbers = _numbers(top, text)
    counts = list(islice(numbers, 2))
    if len(counts) < 2 or not all(_is_count(x, len(text)) for x in counts):
        raise CaptureError(
            f"{top.file}: its second line must have the numbers of cameras and points, got "
            f"{', '.join(f'{x:g}' for x in counts) or 'nothing'}. Copy the file again."
        )
    count, points = map(int, counts)
    within(top.file, "the pictures", count, "frames")
    within(top.file, "the millions of points", points, "points", 1e6)
    cameras = array("d", islice(numbers, _CAMERA * count))
    rows, whole = array("d"), len(cameras) == _CAMERA * count
    for _ in range(points):
        rows.extend(islice(numbers, _POINT))
        views = next(numbers, -1.0)
        # Measurements are skipped.
        length = _MEASUREMENT * int(views) if _is_count(views, len(text)) else -1
        whole = length == sum(1 for _ in islice(numbers, max(length, 0)))
        if not whole:
            break
    rest = next(numbers, None)
    if not whole or rest is not None:
        rule = f"must hold {count} cameras and {points} points, as its second line says, but"
        fault = "is cut off" if rest is None else f"has other numbers, such as {rest:g}"
        raise CaptureError(f"{top.file}: {rule} {fault}. Copy it again.")
    table = np.frombuffer(rows).reshape(points, 2, 3)
    return np.frombuffer(cameras).reshape(count, _CAMERA), table[:, 0], table[:, 1]


def _is_count(number: float, most: int) -> bool:
    return 0 <= number < most and number == int(number)


def _numbers(top: Keys, text: bytes) -> Iterator[float]:
    """The numbers of a text, read a piece at a time."""
    first = 0
    while first < len(text):
        end = _BLANK.search(text, first + _PIECE)
        last = end.start() if end else len(text)
        words = text[first:last].split()
        try:
            # Python takes 1_0 for 10.
            values = np.array(words, np.float64) if b"_" not in text[first:last] else None
        except (ValueError, OverflowError):
            values = None
        if values is None:
            raise CaptureError(f"{top.file}: must hold numbers alone, as Bundler writes it.")
        yield from values.tolist()
        first = last


def _names(top: Keys, count: int) -> list[tuple[str, str]]:
    """The names of the pictures of so many cameras, and the file and line of each."""
    paths = [top.file.parent / name for name in LIST_FILES]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        raise FileNotFoundError(
            f"{top.file}: its list of pictures must be beside it, in the folder around it or in "
            f"prepare/ there: {LIST_FILES[0]}, a line with a name for each camera. Copy it there."
        )
    lines = read_text(path).decode("utf-8-sig", "replace").splitlines()
    names = [
        (_name_in(line.strip()), f"{path}, line {number}")
        for number, line in enumerate(lines, 1)
        if line.strip()
    ]
    if len(names) != count:
        raise CaptureError(
            f"{path}: must have a line for each of the {count} cameras of {top.file}, got "
            f"{len(names)}. Copy the list of pictures that this model was made of."
        )
    return names


def _name_in(line: str) -> str:
    """The name of a picture, which may have blanks, without the numbers that may follow it: 0 and a
    focal length."""
    for _ in range(2):
        words = line.rsplit(None, 1)
        if len(words) == 2 and _NUMBER.fullmatch(words[1]):
            line = words[0]
    return line


def _demand_pictures_inside(folder: Path, top: Keys, names: list[str]) -> None:
    """Refuse the folder of a model whose pictures are in the folder around it."""
    home = folder.resolve().parent
    try:
        beside = [name for name in names if picture_exists(home / name)]
        inner = [name for name in names if picture_exists(folder / name)]
    except (OSError, ValueError):
        return  # names that no file system has
    if top.file.parent == folder and beside and not inner:
        raise CaptureError(
            f"{top.file}: its pictures, such as {beside[0]}, are in the folder around it. Name "
            f"that one: {home}."
        )


def _photograph(
    top: Keys, index: int, name: str, where: str, numbers: Float[np.ndarray, " 15"]
) -> Photograph | None:
    """A camera and its picture; None if it was not registered. The file has the rotation and
    translation to a camera with OpenGL's axes (+y up, looking along -z), and a lens whose distances
    from the axis are those of OpenCV's.

    Args:
        top: the file.
        index: the camera's number in it.
        name: the picture.
        where: the file and line that name the picture.
        numbers: those of the camera.
    """
    focal, k1, k2 = numbers[:3].tolist()
    values = {"focal length": focal, "R": numbers[3:12].tolist()}
    keys = Keys(top.file, values, index, kind="camera")
    if focal == 0:
        return None
    if not (np.isfinite(numbers).all() and focal > 0):
        raise keys.error("focal length", "above 0, and all other numbers finite")
    turn = rotation_in(keys, "R", values["R"]).T
    lens = {"camera_model": "OPENCV", "fl_x": focal, "fl_y": focal, "k1": k1, "k2": k2}
    place = -turn @ numbers[12:]
    return Photograph(name, lens, turn * np.array(BLENDER_AXES), place.tolist(), where)
