"""Captures in the layout of 7-Scenes (Shotton et al. 2013), which tsdf-fusion, 3DMatch and
BundleFusion share: a picture and a text with its pose for each frame."""

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
    MATRIX_FILE,
    lens_of_matrix,
    lines_of,
    missing_lens,
    read_folder_lens,
    read_matrix,
    read_matrix_lens,
)
from gaussray.capture.formats.picture_places import KNOWN_SUFFIXES
from gaussray.capture.formats.posed_pictures import PosedPicture, posed_capture
from gaussray.io.safe.files import read_text


# The file of a frame's pose.
POSE_FILES = "frame-*.pose.txt"
_COLOR = re.compile(r"frame-(\d{1,18})\.color")
# BundleFusion's file, and what it says of the pictures in colour.
_INFO_FILE = "info.txt"
_WIDTH, _HEIGHT, _MATRIX = "m_colorWidth", "m_colorHeight", "m_calibrationColorIntrinsic"


def sevenscenes_file(folder: Path) -> Path | None:
    """The first file of a pose in such a capture; None if there is none, or no picture."""
    path = min(folder.glob(POSE_FILES), default=None)
    return path if path is not None and any(folder.glob("frame-*.color.*")) else None


def sevenscenes_near_miss(folder: Path) -> str:
    """What a folder with poses of such a capture, also in its folders, lacks; empty if it has none,
    or lacks nothing."""
    path = min((*folder.glob(POSE_FILES), *folder.glob(f"*/{POSE_FILES}")), default=None)
    if path is None or sevenscenes_file(path.parent) is not None:
        return ""
    picture = path.name.replace(".pose.txt", ".color.png")
    return (
        f"{path.relative_to(folder)} is a pose of 7-Scenes. It needs the picture {picture} (or "
        ".jpg) beside it, and so does each other pose."
    )


def read_sevenscenes(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The frames of one camera that moves: `frame-000000.color.png` (or .jpg) has its pose in
    `frame-000000.pose.txt`, camera to world in OpenCV's axes.

    The first of n frames, by their numbers, is at time 0 and the last at (n - 1) / n; none is held
    out. Pictures without a pose, or with one that is not finite or 0, are left out with one
    warning. The lens is that of `camera-intrinsics.txt`, of BundleFusion's `info.txt`, `calib.txt`
    or `camera.json`; the middle of the first pixel is 0 in the first three. Depth maps are not
    read.

    Args:
        folder: the folder with the pictures and poses.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a file contradicts the format, or none tells the lens.
        FileNotFoundError: there are no such files.
    """
    folder = Path(folder)
    if sevenscenes_file(folder) is None:
        lacks = f"holds no {POSE_FILES} beside frame-*.color.png or .jpg."
        raise FileNotFoundError(f"{folder}: {sevenscenes_near_miss(folder) or lacks}")
    lens = read_folder_lens(folder)
    if lens is None and (folder / _INFO_FILE).is_file():
        lens = _info(folder / _INFO_FILE)
    around = folder.resolve().parent / MATRIX_FILE
    if lens is None and around.is_file():
        lens = read_matrix_lens(around)
    if lens is None:
        raise missing_lens(folder, f"camera-intrinsics.txt, {_INFO_FILE}")
    found = {
        int(match[1]): path
        for path in sorted(folder.glob("frame-*.color.*"))
        if path.suffix.lower() in KNOWN_SUFFIXES and (match := _COLOR.fullmatch(path.stem))
    }
    numbers = sorted(found)
    count = numbers[-1] - numbers[0] + 1 if numbers else 1
    pictures = []
    for number in numbers:
        path = found[number]
        pose = path.with_name(f"{path.stem.removesuffix('.color')}.pose.txt")
        matrix = read_matrix(pose, 4) if pose.is_file() else None
        time = (number - numbers[0]) / count
        pictures.append(
            PosedPicture(path.name, "sevenscenes", time, lens, Keys(pose, {}, number), matrix)
        )
    return posed_capture(Keys(folder / POSE_FILES, {}), pictures, "normalised", dtype)


def _info(path: Path) -> dict[str, Any]:
    """The lens of the pictures in colour, as keys of a transforms.json."""
    pairs = (line.partition("=") for _, line in lines_of(read_text(path)))
    values = {name.strip(): value.strip() for name, _, value in pairs}
    keys = Keys(path, values)
    try:
        numbers = [float(word) for word in values.get(_MATRIX, "").split()]
        size = [int(values[name]) for name in (_WIDTH, _HEIGHT)]
    except (KeyError, ValueError):
        numbers, size = [], []
    if len(numbers) != 16 or min(size, default=0) < 1:
        raise CaptureError(
            f"{path}: must hold {_WIDTH}, {_HEIGHT} and {_MATRIX} = 16 numbers, as BundleFusion "
            "writes them. Or write the matrix [fx 0 cx; 0 fy cy; 0 0 1] to "
            f"{path.with_name('camera-intrinsics.txt')}."
        )
    matrix = np.reshape(numbers, (4, 4))[:3, :3]
    return {"w": size[0], "h": size[1], **lens_of_matrix(keys, matrix, _MATRIX)}
