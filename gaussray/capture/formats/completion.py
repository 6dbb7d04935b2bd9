"""What the frames of a JSON file leave out: suffixes of pictures, sizes, focal lengths."""

import dataclasses
import math
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.picture_places import (
    KNOWN_SUFFIXES,
    PICTURE_SUFFIXES,
    absent_picture_hint,
    with_found_pictures,
)
from gaussray.capture.picture_file import picture_exists, picture_size
from gaussray.capture.videos import frame_of


def completed(frames: list[Keys]) -> list[Keys]:
    """The frames with the picture's suffix and the intrinsics that they leave out.

    `w` and `h` are those of the first picture that exists (only its header is read), `fl_x` =
    w / (2 tan(camera_angle_x / 2)), `fl_y` = `fl_x` (square pixels), and the optical axis meets the
    picture's centre. A matrix `K` gives all four. Keys that a frame has stay as they are, but paths
    of pictures that lie elsewhere (`picture_places.with_found_pictures`).

    Raises:
        FileNotFoundError: frames name no size, and no picture exists that would tell it.
    """
    named = [_with_matrix(_with_picture(frame)) for frame in with_found_pictures(frames)]
    sized = all(frame.has(key) for frame in named for key in ("w", "h"))
    size = None if sized else first_size(named)
    unsized = [f for f in named if not (f.has("w") or f.has("h"))]
    if size is None and unsized and unsized[0].has("file_path"):
        raise no_picture(unsized[0])
    return [
        dataclasses.replace(frame, values={**frame.values, **_intrinsics(frame, size)})
        for frame in named
    ]


def no_picture(frame: Keys) -> FileNotFoundError:
    """The error about frames of which none has a picture.

    Args:
        frame: the first of them.
    """
    name, folder = frame.text("file_path"), frame.file.parent
    remedy = "Copy the pictures there, or correct the paths."
    return FileNotFoundError(
        f"{frame.where}: file_path must name a picture, got {name!r}: neither it nor another "
        f"frame's picture is in {folder}.{absent_picture_hint(folder, [name], remedy)}"
    )


def first_size(frames: list[Keys]) -> tuple[int, int] | None:
    """Width and height of the first picture that exists; None if none does."""
    for frame in frames:
        path = frame.inside("file_path")
        if picture_exists(path):
            return picture_size(path)
    return None


def _with_picture(frame: Keys) -> Keys:
    if not frame.has("file_path"):
        return frame
    given = frame.text("file_path")
    # BlenderNeRF joins folder and name with the separator of the system that it runs on.
    name = given.replace("\\", "/")
    if PurePosixPath(name).suffix.lower() not in KNOWN_SUFFIXES:
        name = _suffixed(frame, name)
    if name == given:
        return frame
    return dataclasses.replace(frame, values={**frame.values, "file_path": name})


def _with_matrix(frame: Keys) -> Keys:
    """The frame with the numbers of its matrix `K`."""
    if not frame.has("K"):
        return frame
    try:
        matrix = np.asarray(frame.values["K"], float)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
        rule = "the matrix [[fl_x, 0, cx], [0, fl_y, cy], [0, 0, 1]] in pixels"
        raise frame.error("K", rule, "Or give fl_x, fl_y, cx and cy.")
    places = {"fl_x": (0, 0), "fl_y": (1, 1), "cx": (0, 2), "cy": (1, 2)}
    given = {key: float(matrix[at]) for key, at in places.items() if not frame.has(key)}
    return dataclasses.replace(frame, values={**frame.values, **given})


def _suffixed(frame: Keys, name: str) -> str:
    for suffix in ("", *PICTURE_SUFFIXES):
        full = dataclasses.replace(frame, values={**frame.values, "file_path": f"{name}{suffix}"})
        path = full.inside("file_path")
        if picture_exists(path) or not suffix and frame_of(path):
            return f"{name}{suffix}"
    return f"{name}{PICTURE_SUFFIXES[0]}"


def _intrinsics(frame: Keys, size: tuple[int, int] | None) -> dict[str, Any]:
    """The intrinsics that a frame does not have."""
    known: dict[str, Any] = {}
    for key, side in zip(("w", "h"), size or (), strict=False):
        if not frame.has(key):
            known[key] = side
    if frame.has("lens") and not frame.has("camera_angle_x"):
        focal = None
    elif frame.has("fl_x"):
        focal = frame.values["fl_x"]
    else:
        focal = _focal_length(frame, known)
    sizes = {**frame.values, **known}
    width, height = sizes.get("w"), sizes.get("h")
    if not isinstance(width, int | float) or not isinstance(height, int | float):
        return known
    middle = {"fl_x": focal, "fl_y": focal, "cx": width / 2, "cy": height / 2}
    return known | {
        key: value for key, value in middle.items() if value is not None and not frame.has(key)
    }


def _focal_length(frame: Keys, known: dict[str, Any]) -> float | None:
    """Focal length in pixels of a frame with `camera_angle_x`, the horizontal field of view."""
    if not frame.has("camera_angle_x") or not (frame.has("w") or "w" in known):
        return None
    rule = "an angle in radians, above 0 and below pi"
    angle = frame.number("camera_angle_x", remedy=f"Give {rule}, or fl_x in pixels.")
    if not 0 < angle < math.pi:
        raise frame.error("camera_angle_x", rule, "Divide degrees by 57.29578.")
    return frame.count("w", known.get("w", 1)) / (2 * math.tan(angle / 2))
