"""Captures with one JSON file per split, as D-NeRF, NeRF's Blender scenes and BlenderNeRF have."""

import dataclasses
import json
import math
from pathlib import Path, PurePosixPath
from typing import Any

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.lenses import INTRINSICS
from gaussray.capture.formats.paired import Capture, document, frames_of, points_of, views_of
from gaussray.capture.frames import picture_size


# split -> its file. The validation split is neither learnt from nor scored, as in the field.
FILES = {"train": "transforms_train.json", "test": "transforms_test.json"}
VALIDATION = "transforms_val.json"
# Starting points, as BlenderNeRF (and 3D Gaussian splatting) and as 4DGaussians call them.
POINTS = ("points3d.ply", "fused.ply")
SUFFIXES = (".png", ".jpg")  # tried in this order where file_path has none


def read_splits(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The views of `transforms_train.json` (split train) and `transforms_test.json` (split test).

    The layout of D-NeRF (`camera_angle_x` in radians, `file_path` without suffix, `time`) and of
    BlenderNeRF (that, or `fl_x fl_y cx cy w h k1 k2 p1 p2`; no time). Poses, pixel centres and all
    other keys mean what they mean in a paired capture. What a file leaves out: w and h are those of
    its first picture (the header is read, nothing else is opened), fl_x = w / (2 tan(camera_angle_x
    / 2)), fl_y = fl_x (square pixels), the axis meets the picture's centre. Where both are given,
    fl_x counts and camera_angle_x does not; camera_angle_y never does.

    Times stay as written; without any, the capture is static at time 0, with a warning. Only train
    is required; `transforms_val.json` is not read, with a warning. Starting points come from
    `ply_file_path` of the training file, else from points3d.ply, else from fused.ply.

    Raises CaptureError or FileNotFoundError, naming file, frame, key and remedy.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: the capture folder does not exist.")
    if not (folder / FILES["train"]).is_file():
        raise CaptureError(
            f"{folder}: a capture of splits must hold {FILES['train']}, got none. "
            "Add the file, or name the folder that has it."
        )
    paths = {name: folder / file for name, file in FILES.items()}
    tops = {name: document(path) for name, path in paths.items() if path.is_file()}
    main = tops["train"]
    if (folder / VALIDATION).is_file():
        main.warn(f"{VALIDATION} beside it is not read: only train and test are used.")
    listed = {name: frames_of(top) for name, top in tops.items()}
    static = _static(main, listed)
    views = []
    for name, top in tops.items():
        views += views_of(top, _completed(listed[name], name, static), dtype)
    times = [view.time for view in views]
    span = min(times), max(times)
    return Capture(
        folder, views, {}, points_of(main, POINTS), span, main.text("time_unit", "normalised")
    )


def _static(main, listed):
    """Whether no frame of any split has a time; one split with and one without is an error."""
    timed = [any(frame.has("time") for frame in frames) for frames in listed.values()]
    if not any(timed):
        main.warn("no frame has a time: the capture is taken as static, at time 0.")
    for frames, has in zip(listed.values(), timed, strict=True):
        if any(timed) and not has:
            raise frames[0].error(
                "time",
                "a number, as in the other split",
                "Give the frames of both files their time, or none of them (a static capture).",
            )
    return not any(timed)


def _completed(frames, split, static):
    """The frames with all that a view is made of: picture, intrinsics, split, camera, time."""
    pictures = [_picture(frame) for frame in frames]
    size = picture_size(frames[0].file.parent / pictures[0])
    names: dict[str, str] = {}
    completed = []
    for frame, picture in zip(frames, pictures, strict=True):
        given = {key: value for key, value in frame.values.items() if value is not None}
        known = _intrinsics(dataclasses.replace(frame, values=given), size) | {"split": split}
        if static:
            known["time"] = 0.0
        values = {**known, **given, "file_path": picture}
        values.setdefault("camera", _camera(values, names, static))
        completed.append(dataclasses.replace(frame, values=values))
    first = completed[0]
    if (first.count("w"), first.count("h")) != size:
        raise CaptureError(
            f"{first.where}: w and h must be those of its picture, got {first.values['w']} x "
            f"{first.values['h']}, but {first.file.parent / pictures[0]} is {size[0]} x {size[1]}. "
            "Correct w and h and with them fl_x, fl_y, cx and cy, or resize the pictures."
        )
    return completed


def _picture(frame):
    """`file_path` as its file is called, relative to the document."""
    # BlenderNeRF joins folder and name with the separator of the system that it runs on.
    named = frame.text("file_path").replace("\\", "/")
    for suffix in ("", *SUFFIXES):
        full = {**frame.values, "file_path": f"{named}{suffix}"}
        if dataclasses.replace(frame, values=full).inside("file_path").is_file():
            return f"{named}{suffix}"
    raise FileNotFoundError(
        f"{frame.where}: file_path must name a picture, got {named!r}: neither it nor one with "
        f"{' or '.join(SUFFIXES)} is in {frame.file.parent}. Copy it there, or remove the frame."
    )


def _intrinsics(frame, size) -> dict[str, Any]:
    """What the frame's picture and `camera_angle_x` tell of its lens."""
    width, height = frame.count("w", size[0]), frame.count("h", size[1])
    known: dict[str, Any] = {"w": width, "h": height, "cx": width / 2, "cy": height / 2}
    if frame.has("fl_x"):
        return known | {"fl_y": frame.number("fl_x")}
    if frame.has("lens") and not frame.has("camera_angle_x"):
        return known
    rule = "an angle in radians, above 0 and below pi"
    angle = frame.number("camera_angle_x", remedy=f"Give {rule}, or fl_x in pixels.")
    if not 0 < angle < math.pi:
        raise frame.error("camera_angle_x", rule, "Divide degrees by 57.29578.")
    focal = width / (2 * math.tan(angle / 2))
    return known | {"fl_x": focal, "fl_y": focal}


def _camera(values, names, static):
    """Name of the camera that took a frame: the picture's path, with _ between its folders.

    A camera's frames are compared with each other to find what moves, so only pictures from one
    place may share it. A monocular capture moves on with every frame, and each is a camera of its
    own; frames of one pose and one lens are one camera, named after the first. In a static capture
    nothing can be told from equal poses, and each frame keeps its own name.
    """
    path = PurePosixPath(values["file_path"])
    parts = [part for part in path.with_suffix("").parts if part not in ("/", "..")]
    name = "_".join(parts)
    if static:
        return name
    same = {key: values.get(key) for key in ("transform_matrix", "trajectory", *INTRINSICS, "lens")}
    return names.setdefault(json.dumps(same, sort_keys=True), name)
