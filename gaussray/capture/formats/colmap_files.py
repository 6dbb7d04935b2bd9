"""Reads COLMAP's model files, binary or text: cameras, images and points."""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from gaussray.capture.errors import CaptureError
from gaussray.capture.points import Points
from gaussray.capture.world_origin import counted_positions
from gaussray.color import srgb_decode
from gaussray.io.safe.files import opened, read_binary, read_text
from gaussray.io.safe.limits import within


_T = TypeVar("_T")

# Folders of a model's files, in a capture's folder.
PLACES = ("sparse/0", "sparse", "colmap/sparse/0", ".")
# Number and name of each camera model, and its parameters in order.
COLMAP_MODELS: dict[int, tuple[str, tuple[str, ...]]] = {
    0: ("SIMPLE_PINHOLE", ("f", "cx", "cy")),
    1: ("PINHOLE", ("fl_x", "fl_y", "cx", "cy")),
    2: ("SIMPLE_RADIAL", ("f", "cx", "cy", "k1")),
    3: ("RADIAL", ("f", "cx", "cy", "k1", "k2")),
    4: ("OPENCV", ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")),
    5: ("OPENCV_FISHEYE", ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4")),
    6: (
        "FULL_OPENCV",
        ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    ),
    8: ("SIMPLE_RADIAL_FISHEYE", ("f", "cx", "cy", "k1")),
    9: ("RADIAL_FISHEYE", ("f", "cx", "cy", "k1", "k2")),
    10: (
        "THIN_PRISM_FISHEYE",
        ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "s1", "s2"),
    ),
}
_NUMBERS = {name: number for number, (name, _) in COLMAP_MODELS.items()}


class Registered(NamedTuple):
    """A registered picture: camera_from_world rotation (wxyz) and translation in OpenCV axes, and
    the number of its camera."""

    name: str
    quat: tuple[float, ...]
    translation: tuple[float, ...]
    camera: int


class Model(NamedTuple):
    """A COLMAP model.

    Args:
        file: the file with the images, for messages.
        cameras: by number, the keys of a capture's JSON (`camera_model w h fl_x ...`).
        images: the registered pictures.
        points: the points; None if there are none.
    """

    file: Path
    cameras: dict[int, dict[str, Any]]
    images: list[Registered]
    points: Points | None


def model_folder(folder: Path) -> Path | None:
    """The folder with the files of a capture's model, None if there is none."""
    for place in PLACES:
        for suffix in (".bin", ".txt"):
            names = [folder / place / f"{name}{suffix}" for name in ("cameras", "images")]
            if all(path.is_file() for path in names):
                return folder / place
    return None


def larger_models(folder: Path) -> dict[str, int]:
    """The models beside one of COLMAP's numbered ones (sparse/0) that have more pictures, with
    their numbers of pictures, and its own first; empty if there is none."""
    own = _image_count(folder)
    others = {
        path.name: count
        for path in sorted(folder.parent.iterdir())
        if path.name.isdecimal() and path != folder and (count := _image_count(path)) > own
    }
    return {folder.name: own, **others} if folder.name.isdecimal() and others else {}


def _image_count(folder: Path) -> int:
    """How many pictures a model says that it has; 0 if there is none."""
    for name in ("images.bin", "images.txt"):
        path = folder / name
        if not path.is_file():
            continue
        if name == "images.bin":
            with opened(path) as file:
                head = file.read(8)
            return int.from_bytes(head, "little") if len(head) == 8 else 0
        lines = read_text(path).splitlines()
        return sum(1 for line in lines if not line.startswith(b"#")) // 2
    return 0


def read_colmap_model(folder: Path) -> Model:
    """Read a model: `cameras`, `images` and, if it exists, `points3D`, all `.bin` or all `.txt`.

    Memory is allocated only for data that the files hold.

    Raises:
        CaptureError: a file is malformed or truncated, or a camera model is not supported.
        OSError: a file cannot be read.
    """
    suffix = ".bin" if (folder / "cameras.bin").is_file() else ".txt"
    cameras, images, points = (folder / f"{n}{suffix}" for n in ("cameras", "images", "points3D"))
    binary = suffix == ".bin"
    known = dict((_binary_cameras if binary else _text_cameras)(cameras))
    listed = sorted((_binary_images if binary else listed_images)(images))
    if not listed:
        raise CaptureError(f"{images}: the model must have at least one image, got none.")
    for image in listed:
        if image.camera not in known:
            raise CaptureError(
                f"{images}: the camera of {image.name} must be in {cameras.name}, got number "
                f"{image.camera}."
            )
    table = []
    if points.is_file():
        table = list((_binary_points if binary else _text_points)(points))
    return Model(images, known, listed, _points(points, table))


def _camera(path, number, model, size, read) -> tuple[int, dict[str, Any]]:
    """A camera's number and keys; `read(count)` reads its parameters."""
    if model not in COLMAP_MODELS:
        raise CaptureError(
            f"{path}: the model of camera {number} must be one of {', '.join(_NUMBERS)}, "
            f"got {model!s:.80}. Run `colmap image_undistorter` on the pictures and use what it "
            "writes."
        )
    name, names = COLMAP_MODELS[model]
    values: dict[str, Any] = dict(zip(names, read(len(names)), strict=True))
    if "f" in values:
        values["fl_x"] = values["fl_y"] = values.pop("f")
    kind = "OPENCV_FISHEYE" if name.endswith("RADIAL_FISHEYE") else name
    return number, {**values, "camera_model": kind, "w": size[0], "h": size[1]}


def _points(path, table) -> Points | None:
    if not table:
        return None
    rows = np.array(table, np.float64)
    if not np.isfinite(rows).all():
        raise CaptureError(f"{path}: points must be finite, got {rows[~np.isfinite(rows)][0]}.")
    color = srgb_decode(rows[:, 3:] / 255)
    return Points(counted_positions(rows[:, :3]).astype(np.float32), color.astype(np.float32))


class _Bytes:
    """Reads a little-endian binary file from its start, never beyond its end."""

    def __init__(self, path: Path):
        self.path, self.data, self.at = path, read_binary(path), 0

    def unpack(self, layout: str) -> tuple:
        size = struct.calcsize("<" + layout)
        self.skip(size)
        return struct.unpack_from("<" + layout, self.data, self.at - size)

    def skip(self, size: int) -> None:
        if size > len(self.data) - self.at:
            raise CaptureError(
                f"{self.path}: the file must go on for {size} bytes after byte {self.at}, got "
                f"{len(self.data) - self.at}; it is truncated or no file of COLMAP. Copy it again."
            )
        self.at += size

    def rows(self) -> range:
        count = self.unpack("Q")[0]
        # A count above the number of bytes fails later, at the end of the file.
        within(self.path, "the millions of rows", min(count, len(self.data)), "points", 1e6)
        return range(count)

    def text(self) -> str:
        end = self.data.find(b"\0", self.at)
        start = self.at
        self.skip((end if end >= 0 else len(self.data)) + 1 - start)
        return self.data[start:end].decode("utf-8", "replace")


def _binary_cameras(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    file = _Bytes(path)
    for _ in file.rows():
        number, model, *size = file.unpack("IiQQ")
        yield _camera(path, number, model, size, lambda count: file.unpack(f"{count}d"))


def _binary_images(path: Path) -> Iterator[Registered]:
    file = _Bytes(path)
    for _ in file.rows():
        _, *pose, camera = file.unpack("I7dI")
        yield Registered(file.text(), tuple(pose[:4]), tuple(pose[4:]), camera)
        file.skip(24 * file.unpack("Q")[0])


def _binary_points(path: Path) -> Iterator[tuple[float, ...]]:
    file = _Bytes(path)
    for _ in file.rows():
        _, *point, _, track = file.unpack("Q3d3BdQ")
        file.skip(8 * track)
        yield tuple(point)


def _text_cameras(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    def parse(line: str) -> tuple[int, dict[str, Any]]:
        number, model, *rest = line.split()
        size, parameters = [int(word) for word in rest[:2]], [float(word) for word in rest[2:]]

        def read(count: int) -> list[float]:
            if len(parameters) != count:
                raise ValueError(f"{model} has {count} parameters")
            return parameters

        return _camera(path, int(number), _NUMBERS.get(model, model), size, read)

    return _parsed(path, parse)


def listed_images(path: Path) -> Iterator[Registered]:
    """The pictures of images.txt, as they are read."""

    def parse(line: str) -> Registered:
        words = line.split(maxsplit=9)
        if len(words) < 10:
            raise ValueError("an image has nine numbers and a name")
        _, *pose, camera, name = words
        numbers = tuple(float(word) for word in pose)
        return Registered(name.strip(), numbers[:4], numbers[4:], int(camera))

    return _parsed(path, parse, lines=2)


def _text_points(path: Path) -> Iterator[tuple[float, ...]]:
    def parse(line: str) -> tuple[float, ...]:
        words = line.split()
        if len(words) < 8:
            raise ValueError("a point has at least eight numbers")
        return tuple(float(word) for word in words[1:7])

    return _parsed(path, parse)


def _parsed(path: Path, parse: Callable[[str], _T], lines: int = 1) -> Iterator[_T]:
    """Parse the first line of every `lines` lines, without comments."""
    listed = enumerate(read_text(path).decode("utf-8-sig", "replace").splitlines(), 1)
    for number, line in listed:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            yield parse(line)
        except CaptureError:
            raise
        except ValueError as error:
            raise CaptureError(
                f"{path}: line {number} must be as COLMAP writes it, got {line[:200]!r} "
                f"({str(error)[:200]})."
            ) from None
        for _ in range(lines - 1):
            next(listed, None)
