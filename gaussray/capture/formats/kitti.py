"""Captures in the layout of KITTI's odometry (Geiger et al. 2012): pictures in `image_2/`, a line
with the pose of each, and projections of rectified cameras in `calib.txt`."""

import itertools
import re
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike, Float

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.number_files import (
    columns_of,
    lens_of_matrix,
    lines_of,
    numbers_of_words,
    read_rows,
)
from gaussray.capture.formats.picture_folder import only_picture_folder
from gaussray.capture.formats.picture_places import KNOWN_SUFFIXES
from gaussray.capture.formats.posed_pictures import PosedPicture, posed_capture
from gaussray.capture.formats.project_files import head_of
from gaussray.io.natural_order import natural_order
from gaussray.io.safe.files import read_text


# Folders of the pictures of a left and a right camera, and the numbers of their projections. The
# first pair that is there is read: that of colour pictures.
_PAIRS = (
    {"image_2": 2, "image_3": 3},
    {"image_0": 0, "image_1": 1},
    {"image_l": 0, "image_r": 1},
)
# Without them, and beside a projection, the pictures of one camera are in this folder, or in the
# only one of pictures.
_FOLDER = "images"
_POSES_FILE, KITTI_CALIBRATION, _TIMES_FILE = "poses.txt", "calib.txt", "times.txt"
_OTHER_POSES = ("ground_truth.txt", "groundtruth.txt")
# Files that are looked at for poses, at most.
_LOOKED_AT = 50
_LABEL = re.compile(r"P(?:_rect_0)?(\d):\s*(.*)")
_ROW = "twelve numbers: three rows of four of a matrix from the camera to the world"
_PROJECTION = "twelve finite numbers: three rows of four of K [I | t] of a rectified camera"


class _Camera(NamedTuple):
    """A rectified camera: its lens, and its place in the axes of camera 0."""

    lens: dict[str, float]
    place: Float[np.ndarray, "3"]


def kitti_file(folder: Path) -> Path | None:
    """The file of poses of such a capture; None if the folder holds none, or no pictures.

    It is `poses.txt`, `NN.txt`, or `poses/NN.txt` beside `sequences/`, where NN is the name of the
    folder, else `ground_truth.txt`. Beside a calibration, the only other text of twelve columns
    will do. Pictures in another folder than KITTI's own need a projection in the calibration.
    """
    if not _cameras(folder):
        return None
    known, others = _poses_files(folder)
    if known:
        return known[0]
    only = len(others) == 1 and (folder / KITTI_CALIBRATION).is_file()
    return others[0] if only else None


def kitti_near_miss(folder: Path) -> str:
    """What a folder with poses of such a capture lacks; empty if it has none, or lacks nothing."""
    known, others = _poses_files(folder)
    if not known and not others or kitti_file(folder) is not None:
        return ""
    lacking = []
    if not known and len(others) > 1:
        lacking.append(f"one file of poses, to be called {_POSES_FILE}")
    cameras, calibration = _picture_folders(folder), folder / KITTI_CALIBRATION
    if not (calibration.is_file() if has_kitti_folders(folder) else _has_projection(calibration)):
        lacking.append(f"{KITTI_CALIBRATION} with projections (P0: and twelve numbers)")
    if not cameras:
        lacking.append(f"pictures in image_2/, image_0/, image_l/ or {_FOLDER}/")
    needs = " and ".join(lacking)
    first = [*known, *others][0].name
    return f"{first} has twelve numbers a line, as poses of KITTI have. It needs {needs}."


def is_kitti_without_poses(folder: Path) -> bool:
    """Whether a folder has pictures and projections of KITTI (`P0: ...`), but no poses."""
    calibration = folder / KITTI_CALIBRATION
    if any(_poses_files(folder)) or not _cameras(folder):
        return False
    return has_kitti_projections(calibration)


def has_kitti_projections(path: Path) -> bool:
    """Whether a file has projections with KITTI's labels, `P0: ...` or `P_rect_00: ...`."""
    labelled = (_LABEL.fullmatch(line) for _, line in lines_of(head_of(path)))
    return _has_projection(path) and any(labelled)


def kitti_matrices(path: Path) -> dict[str, Float[np.ndarray, "3 3"]]:
    """The camera matrix of each projection in a calibration, by its name, `P0`; the middle of the
    first pixel is 0."""
    return {f"P{k}": matrix[:, :3] for k, (_, matrix) in _projections(path).items()}


def has_kitti_folders(folder: Path) -> bool:
    """Whether a folder has KITTI's own folders of pictures, such as `image_2/`."""
    return bool(_pair(folder))


def _pair(folder: Path) -> dict[str, int]:
    """The first of KITTI's pairs of folders that is there, with the numbers of its projections."""
    there = (pair for pair in _PAIRS if any((folder / name).is_dir() for name in pair))
    return dict(next(there, {}))


def _picture_folders(folder: Path) -> dict[str, int | None]:
    """The folders of pictures with the numbers of their projections; None is the first one of the
    calibration."""
    if pair := _pair(folder):
        return {**pair}
    place = only_picture_folder(folder, (_FOLDER,))
    return {} if place is None else {place.name: None}


def _cameras(folder: Path) -> dict[str, int | None]:
    """Those folders of pictures; of one of another name than KITTI's only a projection tells that
    it is one of its cameras."""
    known = has_kitti_folders(folder) or _has_projection(folder / KITTI_CALIBRATION)
    return _picture_folders(folder) if known else {}


def _has_projection(path: Path) -> bool:
    """Whether a line of a calibration has twelve numbers, with a label or without."""
    lines = lines_of(head_of(path)) if path.is_file() else []
    matches = ((_LABEL.fullmatch(line), line) for _, line in lines)
    words = ((match[2] if match else line).split() for match, line in matches)
    return any(len(some) == 12 and numbers_of_words(some) is not None for some in words)


def _poses_files(folder: Path) -> tuple[list[Path], list[Path]]:
    """The files with twelve columns that have a name of a file of poses, and other texts."""
    home = folder.resolve()
    own = f"{home.name}.txt"
    paths = [folder / _POSES_FILE, folder / own, *sorted(folder.glob("[0-9][0-9].txt"))]
    paths.append(home.parent.parent / "poses" / own)
    paths += [folder / name for name in _OTHER_POSES]
    texts = itertools.islice(folder.glob("*.txt"), _LOOKED_AT)
    others = [path for path in sorted(texts) if not path.name.startswith("calib")]
    known = [path for path in dict.fromkeys(paths) if columns_of(path) == 12]
    return known, [path for path in others if path not in paths and columns_of(path) == 12]


def read_kitti(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The pictures of a camera that moves, or of a left and a right one.

    A line of the poses takes camera 0 to the world, in OpenCV's axes. It belongs to the picture of
    its number, from 0, or in order where there are as many lines as pictures. The lens and place of
    camera i follow from its projection Pi = K [I | t] in `calib.txt` (`P2: ...`, or a line for each
    from P0); pictures in another folder than KITTI's have the first projection. The middle of the
    first pixel is 0. Times are seconds, of `times.txt`; without it picture i of n is at time i / n.
    None is held out.

    Args:
        folder: the folder with `image_2/` (and `image_3/`), else with `image_0/` (and `image_1/`)
            or `image_l/` (and `image_r/`), else with `images/` or a single folder of pictures.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a file contradicts the format; the message names it and the line.
        FileNotFoundError: there are no poses, or no calibration.
    """
    folder = Path(folder)
    path = kitti_file(folder)
    if path is None:
        lacks = (
            f"holds no {_POSES_FILE} with twelve numbers a line beside image_2/, image_0/, "
            f"image_l/ or {_FOLDER}/."
        )
        raise FileNotFoundError(f"{folder}: {kitti_near_miss(folder) or lacks}")
    calibration = folder / KITTI_CALIBRATION
    if not calibration.is_file():
        raise FileNotFoundError(
            f"{calibration}: no such file. It must have the projections of the cameras, such as "
            "P2: fx 0 cx tx 0 fy cy ty 0 0 1 tz."
        )
    cameras = _cameras(folder)
    filmed = {name: _pictures(folder / name) for name in cameras}
    filmed = {name: pictures for name, pictures in filmed.items() if pictures}
    if not filmed:
        raise CaptureError(f"{folder}: {' and '.join(cameras)} must hold pictures, got none.")
    top = Keys(calibration, {})
    every = (name for pair in _PAIRS for name in pair if name not in cameras)
    others = [name for name in every if (folder / name).is_dir()]
    if others:
        top.warn(f"{', '.join(filmed)} is read, and {', '.join(others)} is not.")
    projections = _projections(calibration)
    if None in cameras.values() and len(projections) > 1:
        top.warn(
            f"{', '.join(filmed)} is taken as the pictures of P{next(iter(projections))}, the "
            "first projection. Call the folder image_2 for those of P2, for example."
        )
    rows = read_rows(path, 12, _ROW)
    times = _times(folder, len(rows))
    pictures = []
    for name, numbered in filmed.items():
        camera = _camera(calibration, projections, cameras[name])
        in_order = len(numbered) == len(rows)
        for k, (number, picture) in enumerate(numbered):
            line = k if in_order else number
            source, values = rows[line] if line < len(rows) else (Keys(path, {}), None)
            pose = None if values is None else np.reshape(values, (3, 4))
            time = times[line] if line < len(rows) else 0.0
            pictures.append(
                PosedPicture(
                    f"{name}/{picture.name}", name, time, camera.lens, source, _at(pose, camera)
                )
            )
    unit = "seconds" if (folder / _TIMES_FILE).is_file() else "normalised"
    return posed_capture(top, pictures, unit, dtype)


def _pictures(folder: Path) -> list[tuple[int, Path]]:
    """The pictures of a camera with the numbers in their names; by their order, where these are
    not all different."""
    inside = sorted(folder.iterdir(), key=natural_order) if folder.is_dir() else []
    paths = [path for path in inside if path.suffix.lower() in KNOWN_SUFFIXES]
    found = [re.findall(r"\d{1,18}", path.stem) for path in paths]
    numbers = [int(some[-1]) if some else -1 for some in found]
    if len(set(numbers)) < len(paths) or -1 in numbers:
        numbers = list(range(len(paths)))
    return sorted(zip(numbers, paths, strict=True))


def _times(folder: Path, count: int) -> list[float]:
    """The time of each pose."""
    path = folder / _TIMES_FILE
    if not path.is_file():
        return [k / count for k in range(count)]
    rows = read_rows(path, 1, "a time in seconds")
    if len(rows) != count:
        raise CaptureError(
            f"{path}: must hold a time for each of the {count} poses, got {len(rows)}. Remove it "
            "to have pictures at even times."
        )
    wrong = next((keys for keys, values in rows if not np.isfinite(values[0])), None)
    if wrong is not None:
        raise wrong.error("it", "a finite time in seconds")
    return [float(values[0]) for _, values in rows]


def _projections(path: Path) -> dict[int, tuple[Keys, Float[np.ndarray, "3 4"]]]:
    """The projections in a calibration by their numbers. Lines with other labels are none."""
    found: dict[int, tuple[Keys, Float[np.ndarray, "3 4"]]] = {}
    for k, (number, line) in enumerate(lines_of(read_text(path))):
        match = _LABEL.fullmatch(line)
        if match is None and ":" in line:
            continue
        keys = Keys(path, {"it": line}, number, kind="line")
        try:
            values = np.array((match[2] if match else line).split(), np.float64)
        except ValueError:
            values = np.empty(0)
        if len(values) != 12 or not np.isfinite(values).all():
            raise keys.error("it", _PROJECTION)
        found[int(match[1]) if match else k] = keys, values.reshape(3, 4)
    return found


def _camera(
    path: Path, projections: dict[int, tuple[Keys, Float[np.ndarray, "3 4"]]], number: int | None
) -> _Camera:
    """The camera of a projection, of the first one if no number is given."""
    number = next(iter(projections), 0) if number is None else number
    if number not in projections:
        known = ", ".join(f"P{k}" for k in projections) or "none"
        raise CaptureError(f"{path}: must have the projection P{number}: ..., got {known}.")
    keys, matrix = projections[number]
    lens = lens_of_matrix(keys, matrix[:, :3], f"P{number}, the first three columns,")
    return _Camera(lens, -np.linalg.solve(matrix[:, :3], matrix[:, 3]))


def _at(pose: Float[np.ndarray, "3 4"] | None, camera: _Camera) -> Float[np.ndarray, "3 4"] | None:
    """The pose of a camera, by that of camera 0."""
    if pose is None:
        return None
    return np.column_stack([pose[:, :3], pose[:, 3] + pose[:, :3] @ camera.place])
