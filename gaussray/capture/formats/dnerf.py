"""Captures with one JSON file per split, as D-NeRF, NeRF's Blender scenes and BlenderNeRF have."""

import dataclasses
from pathlib import Path, PurePosixPath

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.camera_names import pose_and_lens
from gaussray.capture.formats.completion import completed, first_size, no_picture
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.transforms import frames_of, points_of, read_document, views_of


# The file of each split. The validation split is neither trained on nor scored.
SPLIT_FILES = {"train": "transforms_train.json", "test": "transforms_test.json"}
VALIDATION_FILE = "transforms_val.json"
# Starting points, by the names of BlenderNeRF (and 3D Gaussian splatting) and of 4DGaussians.
_POINT_FILES = ("points3d.ply", "fused.ply")


def read_splits(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The views of `transforms_train.json` (split train) and `transforms_test.json` (split test).

    The layout of D-NeRF (`camera_angle_x` in radians, `file_path` without suffix, `time`) and of
    BlenderNeRF (that, or `fl_x fl_y cx cy w h k1 k2 p1 p2`; no time). Poses, pixel centres and all
    other keys mean what they mean in a paired capture; `completion` says how missing intrinsics
    follow from the first picture and `camera_angle_x`. `fl_x` has precedence over `camera_angle_x`;
    `camera_angle_y` is not used.

    Times stay as written; without any, the capture is static at time 0, with a warning. Only train
    is required; `transforms_val.json` is not read, with a warning. Starting points come from
    `ply_file_path` of the training file, else from points3d.ply, else from fused.ply.

    Args:
        folder: the folder with the JSON files, which `file_path` is relative to.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a file contradicts the format; the message names file, frame, key and remedy.
        FileNotFoundError: the folder, or every training picture, does not exist. Where every test
            picture is missing, a warning says that none is held out.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: the capture folder does not exist.")
    if not (folder / SPLIT_FILES["train"]).is_file():
        raise CaptureError(
            f"{folder}: a capture of splits must hold {SPLIT_FILES['train']}, got none. "
            "Add the file, or name the folder that has it."
        )
    paths = {name: folder / file for name, file in SPLIT_FILES.items()}
    tops = {name: read_document(path) for name, path in paths.items() if path.is_file()}
    main = tops["train"]
    if (folder / VALIDATION_FILE).is_file():
        main.warn(f"{VALIDATION_FILE} beside it is not read: only train and test are used.")
    listed = {name: frames_of(top) for name, top in tops.items()}
    static = _static(main, listed)
    views = []
    for name, top in tops.items():
        try:
            frames = _named(listed[name], name, static)
        except FileNotFoundError as error:
            if name == "train":
                raise
            top.warn(f"nothing is held out, for none of its pictures exists: {error}")
            continue
        views += views_of(top, frames, dtype)
    times = [view.time for view in views]
    span = min(times), max(times)
    return Capture(
        folder, views, {}, points_of(main, _POINT_FILES), span, main.text("time_unit", "normalised")
    )


def _static(main: Keys, listed: dict[str, list[Keys]]) -> bool:
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


def _named(frames: list[Keys], split: str, static: bool) -> list[Keys]:
    """The frames, completed, with split, camera and (in a static capture) time 0."""
    for frame in frames:
        frame.text("file_path")
    # `null` counts as absent: it must not replace what is derived here.
    given = [
        dataclasses.replace(frame, values={k: v for k, v in frame.values.items() if v is not None})
        for frame in frames
    ]
    complete = completed(given)
    _check_size(complete)
    names: dict[str, str] = {}
    named = []
    for frame in complete:
        values = {"split": split, **({"time": 0.0} if static else {}), **frame.values}
        frame = dataclasses.replace(frame, values=values)
        if not (frame.has("fl_x") or frame.has("lens")):
            rule = "an angle in radians, above 0 and below pi"
            frame.number("camera_angle_x", remedy=f"Give {rule}, or fl_x in pixels.")
        values.setdefault("camera", _camera(frame, names, static))
        named.append(frame)
    return named


def _check_size(frames: list[Keys]) -> None:
    size, first = first_size(frames), frames[0]
    if size is None:
        raise no_picture(first)
    if (first.count("w"), first.count("h")) != size:
        raise CaptureError(
            f"{first.where}: w and h must be those of its picture, got {first.values['w']} x "
            f"{first.values['h']}, but {first.inside('file_path')} is {size[0]} x {size[1]}. "
            "Correct w and h and with them fl_x, fl_y, cx and cy, or resize the pictures."
        )


def _camera(frame: Keys, names: dict[str, str], static: bool) -> str:
    """Name of the camera of a frame: the picture's path, with _ between its folders.

    The picture of a monocular capture moves on with every frame, and each is a camera of its own;
    frames of one pose and lens are one camera, named after the first. In a static capture each
    frame keeps its own name.
    """
    path = PurePosixPath(frame.text("file_path"))
    parts = [part for part in path.with_suffix("").parts if part not in ("/", "..")]
    name = "_".join(parts)
    return name if static else names.setdefault(pose_and_lens(frame), name)
