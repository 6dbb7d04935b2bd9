"""Captures in the layout of TUM's RGB-D benchmark (Sturm et al. 2012), and those of SLAM programs
that write its trajectories: pictures with timestamps, and timestamps with poses."""

import itertools
import re
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.number_files import (
    COEFFICIENTS_FILE,
    columns_of,
    lens_of_coefficients,
    lines_of,
    missing_lens,
    read_folder_lens,
    read_rows,
)
from gaussray.capture.formats.picture_folder import only_picture_folder
from gaussray.capture.formats.picture_places import KNOWN_SUFFIXES
from gaussray.capture.formats.posed_pictures import (
    NEAREST,
    PosedPicture,
    by_time,
    in_seconds,
    interpolated_poses,
    posed_capture,
)
from gaussray.capture.formats.project_files import head_of
from gaussray.io.safe.files import read_text


# The file of the trajectory, the first of which is read: TUM's, and those of ORB-SLAM.
TRAJECTORY_FILES = (
    "groundtruth.txt",
    "trajectory.txt",
    "CameraTrajectory.txt",
    "KeyFrameTrajectory.txt",
)
_LIST_FILE, _FOLDERS = "rgb.txt", ("rgb", "images")
# Files that are looked at for a trajectory, at most.
_LOOKED_AT = 50
_STAMP = re.compile(r"\d{1,20}(\.\d{0,20})?")
_ROW = "a timestamp, the position x y z and the quaternion x y z w"
# fx fy cx cy and OpenCV's distortion of the pictures in colour, as the benchmark publishes them.
_PUBLISHED = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}


def tum_file(folder: Path) -> Path | None:
    """The trajectory of such a capture; None if the folder holds none, or no timed pictures."""
    paths = (folder / name for name in TRAJECTORY_FILES)
    path = next((path for path in paths if columns_of(path) == 8), None)
    return path if path is not None and _has_pictures(folder) else None


def tum_near_miss(folder: Path) -> str:
    """What a folder with a trajectory of TUM's lacks; empty if it has none, or lacks nothing."""
    texts = itertools.islice(folder.glob("*.txt"), _LOOKED_AT)
    others = [path for path in sorted(texts) if path.name not in (_LIST_FILE, COEFFICIENTS_FILE)]
    known = [folder / name for name in TRAJECTORY_FILES]
    path = next((path for path in (*known, *others) if columns_of(path) == 8), None)
    if path is None or tum_file(folder) is not None:
        return ""
    lacking = []
    if path not in known:
        lacking.append(f"the name {TRAJECTORY_FILES[0]}")
    if not _has_pictures(folder) and _timed_folder(folder) is not None:
        lacking.append(f"a timestamp and a picture on each line of {_LIST_FILE}, or no such file")
    elif not _has_pictures(folder):
        lacking.append(
            f"pictures in {' or '.join(f'{name}/' for name in _FOLDERS)} with timestamps for names "
            f"(or {_LIST_FILE} with a timestamp and a picture on each line)"
        )
    needs = " and ".join(lacking)
    return f"{path.name} has eight numbers a line, as trajectories of TUM have. It needs {needs}."


def read_tum(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The pictures of one camera that moves, by their timestamps.

    `rgb.txt` lists a timestamp and a picture on each line; without it the pictures of `rgb/`, of
    `images/` or of the only folder of pictures have timestamps for names, in seconds or
    nanoseconds. A trajectory has `timestamp tx ty tz qx qy qz qw` on each line, camera to world in
    OpenCV's axes. A picture has the pose of its time (`interpolated_poses`); those further than
    0.02 s from any pose are left out with one warning, and none is held out. The lens is that of
    `camera-intrinsics.txt`, `calib.txt` or `camera.json`, else the published one of TUM's sequences
    if the folder's name has freiburg1, freiburg2 or freiburg3. Depth maps are not read.

    Args:
        folder: the folder with the trajectory and the pictures.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a file contradicts the format, no picture has a pose, or no file tells the
            lens.
        FileNotFoundError: there are no such files.
    """
    folder = Path(folder)
    path = tum_file(folder)
    if path is None:
        lacks = (
            f"holds none of {', '.join(TRAJECTORY_FILES)} with eight numbers a line beside "
            f"{_LIST_FILE}, or pictures in rgb/ whose names are timestamps."
        )
        raise FileNotFoundError(f"{folder}: {tum_near_miss(folder) or lacks}")
    top = Keys(path, {})
    others = [name for name in TRAJECTORY_FILES if columns_of(folder / name) == 8][1:]
    if others:
        top.warn(f"{', '.join(others)} is not read. Move this file away to read another.")
    lens = read_folder_lens(folder) or _published(folder)
    if lens is None:
        raise missing_lens(folder, "camera-intrinsics.txt, calib.txt, camera.json")
    listed = _pictures(folder)
    rows = np.stack([values for _, values in read_rows(path, 8, _ROW)])
    times, wanted = in_seconds(rows[:, 0]), np.array(list(listed))
    matrices, known = interpolated_poses(times, rows[:, 4:], rows[:, 1:4], wanted)
    if not known.any():
        raise CaptureError(
            f"{path}: a pose must be at most {NEAREST} s from a picture, but those of {len(rows)} "
            f"poses are from {times.min():.10g} to {times.max():.10g} s, and those of "
            f"{len(wanted)} pictures from {wanted.min():.10g} to {wanted.max():.10g} s. Write both "
            "in seconds of one clock."
        )
    pictures = [
        PosedPicture(listed[time], "tum", time, lens, top, matrix if has else None)
        for time, matrix, has in zip(listed, matrices, known, strict=True)
    ]
    return posed_capture(top, pictures, "seconds", dtype)


def _published(folder: Path) -> dict[str, Any] | None:
    """The lens of a sequence of TUM, as keys of a transforms.json; None of any other folder."""
    name = folder.resolve().name.lower()
    numbers = next((numbers for key, numbers in _PUBLISHED.items() if key in name), None)
    return None if numbers is None else lens_of_coefficients(numbers)


def _has_pictures(folder: Path) -> bool:
    if (folder / _LIST_FILE).is_file():
        lines = lines_of(head_of(folder / _LIST_FILE))
        return bool(lines) and _entry(lines[0][1]) is not None
    return _timed_folder(folder) is not None


def _entry(line: str) -> tuple[float, str] | None:
    """The timestamp and the picture of a line; None if it is another."""
    stamp, name = [*line.split(maxsplit=1), ""][:2]
    return (float(stamp), name.strip()) if _STAMP.fullmatch(stamp) and name.strip() else None


def _timed_folder(folder: Path) -> Path | None:
    """The folder of pictures whose names are timestamps: one of the usual names, else the only one
    of pictures."""
    places = [folder / name for name in _FOLDERS if (folder / name).is_dir()]
    only = None if places else only_picture_folder(folder, _FOLDERS)
    places += [] if only is None else [only]
    return next((place for place in places if any(map(_is_timed, place.iterdir()))), None)


def _is_timed(path: Path) -> bool:
    return path.suffix.lower() in KNOWN_SUFFIXES and bool(_STAMP.fullmatch(path.stem))


def _pictures(folder: Path) -> dict[float, str]:
    """The pictures by their times in seconds, in order."""
    path = folder / _LIST_FILE
    found: list[tuple[float, str]] = []
    if path.is_file():
        for number, line in lines_of(read_text(path)):
            entry = _entry(line)
            if entry is None:
                keys = Keys(path, {"it": line}, number, kind="line")
                raise keys.error("it", "a timestamp in seconds and the path of a picture")
            found.append(entry)
    else:
        place = _timed_folder(folder)
        paths = [path for path in place.iterdir() if _is_timed(path)] if place else []
        found = [(float(path.stem), path.relative_to(folder).as_posix()) for path in paths]
    times = in_seconds(np.array([time for time, _ in found]))
    return by_time(folder, times.tolist(), [name for _, name in found])
