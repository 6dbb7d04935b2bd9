"""What readers of structure-from-motion projects share: lens types, blocks, poses and pictures."""

import dataclasses
import re
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import DTypeLike, Float

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.completion import completed
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.picture_folder import media_folder
from gaussray.capture.formats.picture_places import absent_picture_hint
from gaussray.capture.formats.poses import opengl_pose
from gaussray.capture.formats.transforms import views_of
from gaussray.capture.picture_file import picture_exists, picture_size
from gaussray.capture.points import Points
from gaussray.io.safe.limits import within


# Where programs count pixels from that call the middle of the first pixel 0: it is at 0.5 here.
FIRST_PIXEL = 0.5
# Largest difference of a rotation's columns from unit vectors at right angles.
_ORTHOGONAL = 1e-3


class LensType(NamedTuple):
    """A lens of another program: its `camera_model` here, and its coefficients in their order."""

    camera_model: str
    coefficients: tuple[str, ...] = ()


# The lens types of OpenMVG, and of AliceVision, which began as a copy of it.
LENS_TYPES = {
    "pinhole": LensType("PINHOLE"),
    "radial1": LensType("OPENCV", ("k1",)),
    "radial3": LensType("OPENCV", ("k1", "k2", "k3")),
    "brown": LensType("OPENCV", ("k1", "k2", "k3", "p1", "p2")),
    "fisheye4": LensType("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
}


class Photograph(NamedTuple):
    """A picture with its camera.

    Args:
        path: the picture's path, as the project has it.
        lens: keys of its lens, as in a transforms.json. Without `w` and `h`, these are the size of
            the picture, in the middle of which the axis is.
        turn: rotation, camera to world, of a camera with OpenCV's axes.
        place: where the camera is.
        listed: the file and the line that name the picture, for messages; empty: the project's.
    """

    path: str
    lens: Mapping[str, Any]
    turn: Float[np.ndarray, "3 3"]
    place: Sequence[float]
    listed: str = ""


def lens_remedy(tool: str, export: str) -> str:
    """What to do about a lens that cannot be read.

    Args:
        tool: the program.
        export: its command that writes COLMAP's model.
    """
    return (
        f"Undistort the pictures in {tool} and name the project of these, export it to COLMAP "
        f"(`{export}`), or find poses anew with `gaussray prepare`."
    )


def rotation_in(keys: Keys, key: str, rows: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """The rotation of nine finite numbers, row by row.

    Args:
        keys: the block that has it, for the message.
        key: its name there.
        rows: the numbers.

    Raises:
        CaptureError: the matrix is no rotation.
    """
    turn = np.reshape(np.asarray(rows, np.float64), (3, 3))
    # Larger numbers would overflow in the product.
    good = np.abs(turn).max() < 2 and np.abs(turn @ turn.T - np.eye(3)).max() < _ORTHOGONAL
    if not good or np.linalg.det(turn) < 0:
        raise keys.error(key, "a rotation: three unit vectors at right angles, right-handed")
    return turn


def project_capture(
    folder: Path,
    top: Keys,
    listed: Sequence[Photograph | None],
    points: Points | None,
    dtype: DTypeLike,
) -> Capture:
    """The capture of a project's photographs, a still scene of which none is held out.

    Pictures are sought in the folder, also where the project has the paths of another computer.

    Args:
        folder: the capture's folder.
        top: the project's file, which lies in this folder or deeper.
        listed: its photographs; None for each one without a pose, which is left out with a warning.
        points: its points.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: no photograph has a pose, two are of one picture, or a camera is invalid.
        FileNotFoundError: no picture exists that would tell the size of lenses without one.
    """
    within(top.file, "the pictures", len(listed), "frames")
    posed = [photograph for photograph in listed if photograph is not None]
    if not posed:
        raise CaptureError(
            f"{top.file}: at least one picture must have a pose, got none of {len(listed)}. Name "
            "the folder of the project's file after structure from motion, or find poses with "
            f"`gaussray prepare {shlex.quote(f'videos={media_folder(folder) or folder}')} "
            "out=CAPTURE`."
        )
    if len(posed) < len(listed):
        top.warn(f"{len(listed) - len(posed)} of {len(listed)} pictures have no pose: left out.")
    images = _images(folder, top, posed)
    posed = _with_sizes(folder, top, posed, images)
    names = distinct_names(top, folder, images)
    frames = []
    for k, (name, photograph) in enumerate(zip(names, posed, strict=True)):
        # The picture's own path, which may lie outside of the file's folder, replaces this one.
        keys = {"file_path": "picture", "camera": name, "split": "train", "time": 0.0}
        keys["transform_matrix"] = opengl_pose(photograph.turn, photograph.place)
        frames.append(Keys(top.file, {**photograph.lens, **keys}, k, kind="picture"))
    views = [
        dataclasses.replace(view, image=image)
        for view, image in zip(views_of(top, frames, dtype), images, strict=True)
    ]
    return Capture(folder, views, {}, points, (0.0, 0.0), "normalised")


def _images(folder: Path, top: Keys, posed: Sequence[Photograph]) -> list[Path]:
    """The pictures of photographs, in a folder."""
    home = folder.resolve()

    def sought(names: Iterable[str]) -> list[Path]:
        # Sizes, which may not be known yet, say nothing of where pictures are.
        frames: list[Keys] = [
            _Listed(
                folder / top.file.name,
                {"w": 1, "h": 1, "file_path": name},
                place=_place(top, k, photograph),
            )
            for k, (name, photograph) in enumerate(zip(names, posed, strict=True))
        ]
        return [frame.inside("file_path") for frame in completed(frames)]

    paths = sought(_path_in(home, photograph.path) for photograph in posed)
    if not any(map(picture_exists, paths)) and any(map(_is_elsewhere, posed)):
        # They exist where the project says: the message tells how they can be used.
        return sought(photograph.path for photograph in posed)
    return paths


@dataclasses.dataclass(frozen=True)
class _Listed(Keys):
    """The keys of a picture, which messages name by the place that lists it."""

    place: str = ""

    @property
    def where(self) -> str:
        return self.place

    def name_of(self, key: str) -> str:
        return f"{self.place}: the picture"


def _place(top: Keys, index: int, photograph: Photograph) -> str:
    """Where a picture is listed, for messages."""
    return photograph.listed or f"{top.file}, picture {index}"


def _with_sizes(
    folder: Path, top: Keys, posed: Sequence[Photograph], images: Sequence[Path]
) -> list[Photograph]:
    """The photographs, with size and axis of lenses that have none; absent pictures, which are left
    out later, have the size of one that exists."""
    unknown = [k for k, photograph in enumerate(posed) if "w" not in photograph.lens]
    sizes = {k: picture_size(images[k]) for k in unknown if picture_exists(images[k])}
    if unknown and not sizes:
        name = posed[unknown[0]].path
        remedy = "Copy the pictures there, or correct the names."
        raise FileNotFoundError(
            f"{_place(top, unknown[0], posed[unknown[0]])}: must name a picture, got {name!r}: "
            f"neither it nor another one of the list is in {folder}."
            f"{absent_picture_hint(folder, [name], remedy)}"
        )
    sized = []
    for k, photograph in enumerate(posed):
        if "w" not in photograph.lens:
            width, height = sizes.get(k) or next(iter(sizes.values()))
            size = {"w": width, "h": height, "cx": width / 2, "cy": height / 2}
            photograph = photograph._replace(lens={**photograph.lens, **size})
        sized.append(photograph)
    return sized


def _path_in(home: Path, name: str) -> str:
    """A path of any system as one inside a folder: relative to it if it leads there, otherwise
    without its root and steps upwards."""
    path = PurePosixPath(re.sub(r"^[A-Za-z]:", "", name.replace("\\", "/")))
    if path.is_relative_to(home.as_posix()):
        path = path.relative_to(home.as_posix())
    return "/".join(part for part in path.parts if part not in ("/", "//", "..")) or "."


def _is_elsewhere(photograph: Photograph) -> bool:
    try:
        return Path(photograph.path).is_absolute() and Path(photograph.path).is_file()
    except (OSError, ValueError):
        return False


def distinct_names(top: Keys, folder: Path, pictures: Sequence[Path]) -> list[str]:
    """A name for the camera of each picture: the picture's without suffix, with as much of its
    folders and suffix as tells all apart.

    Args:
        top: the file that lists them.
        folder: the capture's folder.
        pictures: at least one.

    Raises:
        CaptureError: two are one picture.
    """
    paths = [path.as_posix().removeprefix(f"{folder.as_posix()}/") for path in pictures]
    path, count = Counter(paths).most_common(1)[0]
    if count > 1:
        raise CaptureError(
            f"{top.file}: each view must have a picture of its own, got {path} {count} times. "
            "Remove the others."
        )
    pure = [PurePosixPath(path) for path in paths]
    bare = [path.with_suffix("").as_posix().replace("/", "_") for path in pure]
    full = [path.as_posix().replace("/", "_") for path in pure]
    for names in ([path.stem for path in pure], [path.name for path in pure], bare, full):
        if len(set(names)) == len(names):
            return names
    return [path.as_posix() for path in pure]
