"""Captures of rigs: cameras that stand still, each with pictures that are numbered in time."""

import dataclasses
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.completion import KNOWN_SUFFIXES
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.transforms import points_of, views_in_time, views_of
from gaussray.capture.videos import VIDEO_SUFFIXES, frame_path, read_video
from gaussray.io.natural_order import natural_order
from gaussray.io.safe.limits import within


# Pictures of one camera by their numbers: paths, or frames of a video, relative to the capture.
Numbered = Mapping[int, str]
_NAMED = 5


def numbered_pictures(folder: Path, paths: Iterable[Path], name: str) -> dict[str, dict[int, str]]:
    """The pictures among some files by camera and number.

    Args:
        folder: the capture's folder, to which the returned paths are relative.
        paths: files in it. What is no picture, or has another name, is left out.
        name: regular expression of the whole path without suffix, relative to the folder, with
            the groups `camera` and `number`.
    """
    found: dict[str, dict[int, str]] = {}
    for path in sorted(paths):
        inside = path.relative_to(folder).as_posix()
        match = re.fullmatch(name, inside.removesuffix(path.suffix))
        if match and path.suffix.lower() in KNOWN_SUFFIXES:
            found.setdefault(match["camera"], {}).setdefault(int(match["number"]), inside)
    return found


def film_of(top: Keys, name: str) -> dict[int, str]:
    """The pictures of one camera, in a folder of its name, or the frames of a video of its name, in
    the capture's folder, its `images/` or its `videos/`; none if there are fewer than two.

    Args:
        top: the file that lists the cameras, in the capture's folder.
        name: name of the camera.

    Returns:
        Paths relative to the capture, by the last number in their names; by their order where
        these are not all different.

    Raises:
        CaptureError: the name leads out of the folder.
        OSError: the video is damaged.
    """
    home = top.file.parent
    Keys(top.file, {"camera": name}).inside("camera")
    places = [home, home / "images", home / "videos"]
    for folder in (place / name for place in places):
        paths = sorted(folder.glob("*"), key=natural_order)
        paths = [path for path in paths if path.suffix.lower() in KNOWN_SUFFIXES]
        if len(paths) > 1:
            numbers = [int(([0, *re.findall(r"\d+", path.stem)])[-1]) for path in paths]
            distinct = len(set(numbers)) == len(paths)
            inside = [path.relative_to(home).as_posix() for path in paths]
            return dict(zip(numbers if distinct else range(len(paths)), inside, strict=True))
    for path in (place / f"{name}{suffix}" for place in places for suffix in VIDEO_SUFFIXES):
        if path.is_file():
            frames = range(read_video(path).frames)
            return {i: frame_path(path, i).relative_to(home).as_posix() for i in frames}
    return {}


def rig_capture(
    top: Keys,
    cameras: Sequence[Keys],
    pictures: Mapping[str, Numbered],
    dtype: DTypeLike = jnp.float32,
) -> Capture:
    """The capture of cameras that stand still.

    Pictures of one number were taken at one time: that of the i-th of n numbers is i / n. Cameras
    without pictures, and pictures of no camera, are left out with a warning. Starting points come
    from points3d.ply, if it exists.

    Args:
        top: the file that lists the cameras.
        cameras: the keys of each as of a frame in a transforms.json, without picture and time.
        pictures: the pictures of each camera by its name.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: no camera has a picture, two have one name, or a camera's keys break their
            rules.
    """
    (name, count), *_ = Counter(camera.text("camera") for camera in cameras).most_common()
    if count > 1:
        raise CaptureError(
            f"{top.file}: each camera must have a name of its own, got {name!r} {count} times."
        )
    filmed = [camera for camera in cameras if pictures.get(camera.text("camera"))]
    if not filmed:
        names = ", ".join(camera.text("camera") for camera in cameras[:_NAMED])
        raise CaptureError(
            f"{top.file}: at least one of its {len(cameras)} cameras ({names} ...) must have "
            "pictures beside it, got none. Check their names (docs/captures.md)."
        )
    if len(filmed) < len(cameras):
        top.warn(
            f"{len(cameras) - len(filmed)} of {len(cameras)} cameras have no pictures: left out."
        )
    known = {camera.text("camera") for camera in cameras}
    others = sorted(name for name in pictures if name not in known)
    if others:
        shown = ", ".join(others[:_NAMED])
        top.warn(f"pictures of {len(others)} cameras that it does not list ({shown}) are not read.")
    of_camera = [pictures[camera.text("camera")] for camera in filmed]
    within(top.file, "the pictures", sum(len(some) for some in of_camera), "frames")
    numbers = sorted({number for some in of_camera for number in some})
    times = {number: i / len(numbers) for i, number in enumerate(numbers)}
    first = [
        dataclasses.replace(
            camera, values={**camera.values, "time": 0.0, "file_path": next(iter(some.values()))}
        )
        for camera, some in zip(filmed, of_camera, strict=True)
    ]
    views = []
    for view, some in zip(views_of(top, first, dtype), of_camera, strict=True):
        ordered = sorted(some)
        images = [Keys(top.file, {"picture": some[i]}).inside("picture") for i in ordered]
        views += views_in_time(view, images, [times[i] for i in ordered])
    span = (min(times.values()), max(times.values()))
    return Capture(top.file.parent, views, {}, points_of(top), span, "normalised")
