"""Paired captures: transforms.json and one more JSON file for each effect."""

import dataclasses
from pathlib import Path, PurePath
from typing import Any

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.completion import completed
from gaussray.capture.formats.dnerf import SPLIT_FILES, VALIDATION_FILE
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.transforms import (
    PINHOLE_FILE,
    frames_of,
    json_content,
    json_if_readable,
    points_of,
    read_document,
    views_of,
)


# Keys of a frame, or of all frames, that hold a pose.
_POSES = ("transform_matrix", "trajectory")


def read_capture(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """Read the JSON files of a paired capture; its pictures are not decoded.

    Args:
        folder: a folder with `transforms.json` (nerfstudio's format with `time`, `camera` and
            `split` for each frame) and, optionally, further JSON files with the frames of effects.
        dtype: type of the cameras' numbers.

    Returns:
        The capture: views, views of each effect, starting points.

    Raises:
        CaptureError: a file contradicts the format; the message names file, frame, key and remedy.
        FileNotFoundError: the folder does not exist.
    """
    folder = Path(folder)
    files = effect_files(folder)
    if not files:
        raise CaptureError(
            f"{folder}: a capture must hold {PINHOLE_FILE} or another JSON file with frames, "
            "got none."
        )
    pinhole = next((name for name, path in files.items() if path.name == PINHOLE_FILE), None)
    groups: dict[str, list[View]] = {}
    for name, path in files.items():
        try:
            groups[name] = read_views(path, dtype)
        except CaptureError as error:
            # A file of another program, beside a transforms.json, is no error of the capture.
            if pinhole is None or name == pinhole or _has_effect(json_content(path)):
                raise
            Keys(path, {}).warn(f"skipped, it is no file of a capture: {error}")
    main = read_document(files[pinhole] if pinhole is not None else next(iter(files.values())))
    points = points_of(main)
    views = groups.pop(pinhole) if pinhole is not None else []
    every = views or [view for some in groups.values() for view in some]
    times = [view.time for view in every]
    unit = main.text("time_unit", "normalised")
    return Capture(folder, views, groups, points, (min(times), max(times)), unit)


def effect_files(folder: Path | str) -> dict[str, Path]:
    """The JSON files of a folder that list frames of a capture, by the name of their effect.

    The name is the file's "effect", or "pinhole" for transforms.json and the stem of any other.
    No part of the capture are JSON files without frames that have a picture and a pose (reports of
    other tools), malformed ones, and, beside transforms.json, those that are named after it
    (transforms_backup.json) and name no effect, which a warning tells.

    Raises:
        CaptureError: two files have one effect.
        FileNotFoundError: the folder does not exist.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: the capture folder does not exist.")
    files: dict[str, Path] = {}
    paths = sorted(folder.glob("*.json"), key=lambda path: (path.name != PINHOLE_FILE, path.name))
    for path in paths:
        held = Keys(folder / PINHOLE_FILE, {"file": path.name}).inside("file")
        main = path.name == PINHOLE_FILE
        content = json_content(held) if main else json_if_readable(held)
        if not isinstance(content, dict) or not (main or _lists_frames(content, bool(files))):
            continue
        if files and not main and "transforms" in path.stem and not _has_effect(content):
            if path.name not in (*SPLIT_FILES.values(), VALIDATION_FILE):
                Keys(path, {}).warn(
                    f"is left out: it is named after {PINHOLE_FILE} and names no effect. To score "
                    'its pictures as one, give it a key effect ("effect": "fisheye").'
                )
            continue
        name = "pinhole" if path.name == PINHOLE_FILE else path.stem
        name = Keys(path, content).text("effect", name)
        if name in files:
            raise CaptureError(
                f"{path}: effect must be unique in a capture, got {name!r}, which "
                f"{files[name].name} has too. Rename one of them."
            )
        files[name] = path
    return files


def read_views(path: Path | str, dtype: DTypeLike = jnp.float32) -> list[View]:
    """The views of all frames of one JSON file, in its order.

    Args:
        path: the JSON file; the paths in it are relative to its folder.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format; the message names frame, key and remedy.
    """
    top = read_document(Path(path))
    return views_of(top, completed(frames_of(top)), dtype)


def read_cameras(path: Path | str, dtype: DTypeLike = jnp.float32) -> list[View]:
    """The views of all frames of one JSON file, for their cameras alone.

    The pictures may lie anywhere and need not exist: the views' `image` is only a name, and masks
    and depth maps are left out.

    Args:
        path: the JSON file; its frames must have their sizes and intrinsics.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format; the message names frame, key and remedy.
    """
    return cameras_in(read_document(Path(path)), dtype)


def cameras_in(top: Keys, dtype: DTypeLike = jnp.float32) -> list[View]:
    """The views of all frames of a document, for their cameras alone (`read_cameras`).

    Args:
        top: the top level of the document (`read_document`).
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the document contradicts the format; the message names frame, key and remedy.
    """
    no_files = dict.fromkeys(("mask_path", "depth_file_path"))
    frames = []
    for frame in frames_of(top):
        parts = PurePath(frame.text("file_path")).parts[-2:]
        name = "/".join(part for part in parts if part not in ("/", "..")) or "picture"
        values = {**frame.values, **no_files, "file_path": name}
        frames.append(dataclasses.replace(frame, values=values))
    return views_of(top, frames, dtype)


def _has_effect(content: dict[str, Any]) -> bool:
    """Whether a JSON document says that it belongs to a paired capture."""
    frames = content.get("frames")
    first = frames[0] if isinstance(frames, list) and frames else None
    return "effect" in content or isinstance(first, dict) and "effect" in first


def _lists_frames(content: dict[str, Any], beside: bool) -> bool:
    """Whether a JSON document is one of a capture: it names an effect, or lists frames. The first
    must have a picture and a pose unless transforms.json is beside it, so that a folder is no
    capture because another tool listed frames in it."""
    frames = content.get("frames")
    first = frames[0] if isinstance(frames, list) and frames else None
    if not isinstance(first, dict):
        return "frames" in content and "effect" in content
    posed = "file_path" in first and any(key in {**content, **first} for key in _POSES)
    return posed or beside or _has_effect(content)
