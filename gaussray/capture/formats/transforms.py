"""Files like nerfstudio's transforms.json: the camera, time and picture of each frame."""

import dataclasses
import difflib
import json
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.camera.camera import Camera
from gaussray.camera.trajectory import Trajectory
from gaussray.capture.capture import View
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.camera_names import with_camera_names
from gaussray.capture.formats.effects import (
    EFFECT_OF_BLOCK,
    quaternions,
    read_aperture,
    read_film,
    read_shutter,
    read_trajectory,
)
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.lenses import INTRINSICS, LENS_LABELS, lens_of
from gaussray.capture.frames import COLOR_SPACES
from gaussray.capture.points import Points, read_points
from gaussray.capture.world_origin import counted_positions
from gaussray.io.plain_values import to_device
from gaussray.io.safe.files import read_json
from gaussray.io.safe.limits import within


PINHOLE_FILE = "transforms.json"
# Similarity of two keys (difflib) from which on one may be meant by the other.
_ALIKE = 0.7
# Keys that a frame or, for all frames, the top level may have.
_SHARED = {
    *(*INTRINSICS, *EFFECT_OF_BLOCK, "film", "clip_start"),
    *("effect", "samples", "color_space", "time_unit", "K"),
}
_FRAME = {
    *("file_path", "transform_matrix", "time", "camera", "split"),
    *("mask_path", "depth_file_path", "labels"),
}
_TOP = {"frames", "ply_file_path", "static"}
# Keys that nerfstudio, instant-ngp, D-NeRF, Polycam and Record3D write, and that change no camera;
# "info" may hold anything.
_IGNORED = {
    *("info", "aabb_scale", "camera_angle_x", "camera_angle_y", "applied_transform"),
    *("applied_scale", "orientation_override", "auto_scale_poses_override", "colmap_im_id"),
    *("sharpness", "rotation", "train_filenames", "val_filenames", "test_filenames"),
    *("fps", "scale", "offset", "n_frames", "frame", "frame_id", "camera_index", "camera_id"),
    *("camera_label", "is_fisheye", "enable_depth_loading", "integer_depth_scale", "from_na"),
    *("render_aabb", "up", "blur_score", "timestamp", "near", "far", "scene_box", "colmap_id"),
    *("original_fn", "time_id", "semantics", "semantics_path", "normal_file_path", "version"),
    *("ply_file_path", "scene_scale", "scene_center", "contributor", "image_id", "exposure_time"),
    *("fovx", "fovy", "fov_x", "fov_y"),
}
POINT_FILES = ("points3d.ply", "sparse_pc.ply")


def effect_file(effect: str) -> str:
    """The name of the JSON file with the frames of an effect."""
    return PINHOLE_FILE if effect == "pinhole" else f"{effect}.json"


def frames_of(top: Keys) -> list[Keys]:
    """The keys of each frame of a document, with those of the top level that it does not have.

    Raises:
        CaptureError: a frame is no block of keys.
    """
    listed = top.values["frames"]
    _warn_unknown(top, listed)
    shared = {key: value for key, value in top.values.items() if key not in _TOP}
    frames = []
    for k, frame in enumerate(listed):
        if not isinstance(frame, dict):
            raise CaptureError(f"{top.file}: frames[{k}] must be a block of keys, got {frame!r}.")
        frames.append(Keys(top.file, {**shared, **frame}, k))
    return frames


def views_of(top: Keys, frames: list[Keys], dtype: DTypeLike = jnp.float32) -> list[View]:
    """The views that the frames of a document describe, in their order.

    Frames that name no camera get one by their poses (`camera_names`).

    Args:
        top: the top level of the document, for what holds for all frames, and for messages.
        frames: keys of each frame, with those of the top level that it does not have (`frames_of`).
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: a frame contradicts the format; the message names file, frame and key.
    """
    _demand_times(top, frames)
    _warn_splits(top, frames)
    frames = with_camera_names(frames)
    fixed = [None if frame.has("trajectory") else frame.pose() for frame in frames]
    poses = np.array([pose for pose in fixed if pose is not None]).reshape(-1, 3, 4)
    # NumPy: to take a row of it is a thousand times as cheap as of a JAX array.
    rotations = iter(np.asarray(quaternions(poses, dtype))) if len(poses) else iter(())
    made: dict[Hashable, Any] = {}
    return [
        _view(frame, pose, None if pose is None else next(rotations), made, dtype)
        for frame, pose in zip(frames, fixed, strict=True)
    ]


def views_in_time(
    view: View, images: Sequence[Path], times: Sequence[float] | None = None
) -> list[View]:
    """The views of a fixed camera.

    Args:
        view: the camera; all but image and time holds for every picture.
        images: all pictures of the camera, or frames of a video (`videos.frame_path`), in the
            order of their times.
        times: the time of each; None: picture i of n is at time i / n, as 4DGaussians counts.
    """
    if times is None:
        times = [i / len(images) for i in range(len(images))]
    dtype = view.camera.time.dtype
    return [
        dataclasses.replace(
            view,
            image=image,
            time=time,
            camera=dataclasses.replace(view.camera, time=to_device(time, dtype)),
        )
        for image, time in zip(images, times, strict=True)
    ]


def points_of(top: Keys, names: Sequence[str] = POINT_FILES) -> Points | None:
    """Starting points of a capture, from a PLY file; None if there is none.

    Args:
        top: the top level of a document. The file that its `ply_file_path` names is read first.
        names: names of files to look for beside the document; the first that exists is read.
    """
    named = top.path("ply_file_path")
    if named is not None and named.is_file():
        return read_points(named)
    if named is not None:
        top.warn(f"ply_file_path names {named.name}, which does not exist and is not read.")
    beside = [name for name in names if (top.file.parent / name).exists()]
    if len(beside) > 1:
        top.warn(f"{beside[0]} holds the starting points; {', '.join(beside[1:])} is not read.")
    return read_points(top.file.parent / beside[0]) if beside else None


def _view(
    keys: Keys,
    pose: np.ndarray | None,
    rotation: np.ndarray | None,
    made: dict[Hashable, Any],
    dtype: DTypeLike,
) -> View:
    # Frames share most of their camera: each part is built and checked once per distinct content.
    def shared(label: Hashable, build: Callable):
        if label not in made:
            try:
                made[label] = build()
            except CaptureError:
                raise
            except ValueError as error:  # the camera's check does not know the file and frame
                raise CaptureError(f"{keys.where}: {error}") from error
        return made[label]

    def part(name: str, names: tuple[str, ...], build: Callable):
        content = {key: keys.values.get(key) for key in names}
        return shared(name + json.dumps(content, sort_keys=True), build)

    time = keys.number("time", 0.0)
    if pose is None or rotation is None:
        trajectory = part("path", ("trajectory",), lambda: read_trajectory(keys, dtype))
    else:
        still = partial(_standing, pose, rotation, dtype)
        trajectory = shared(("pose", pose.tobytes()), still)
    camera = Camera(
        film=part("film", ("w", "h", "film"), lambda: read_film(keys)),
        lens=part("lens", (*INTRINSICS, "lens"), lambda: lens_of(keys, dtype)),
        aperture=part("aperture", ("aperture",), lambda: read_aperture(keys, dtype)),
        shutter=part("shutter", ("w", "h", "shutter"), lambda: read_shutter(keys, dtype)),
        trajectory=trajectory,
        time=shared(("time", time), lambda: to_device(time, dtype)),
        clip_start=part("clip", ("clip_start",), lambda: _clip_start(keys, dtype)),
    )
    image = keys.inside("file_path")
    return View(
        camera=camera,
        image=image,
        mask=keys.path("mask_path"),
        depth=keys.path("depth_file_path"),
        camera_name=keys.text("camera"),
        split=keys.choice("split", ("train", "test"), _split(keys)),
        time=time,
        effect=keys.text("effect", _label(keys)),
        samples=keys.count("samples") if keys.has("samples") else None,
        color_space=keys.choice("color_space", COLOR_SPACES, "srgb"),
    )


def _standing(pose: np.ndarray, rotation: np.ndarray, dtype: DTypeLike) -> Trajectory:
    """The path of a camera that stands still."""
    place = to_device(counted_positions(pose[None, :, 3]), dtype)
    return Trajectory(to_device([0.0], dtype), to_device(rotation[None]), place)


def _clip_start(keys: Keys, dtype: DTypeLike) -> Any:
    if not keys.has("clip_start"):
        return None
    start = keys.number("clip_start")
    if start < 0:
        raise keys.error("clip_start", "at least 0")
    return to_device(start, dtype)


def _label(keys: Keys) -> str:
    """Effect of a frame that names none, from its blocks."""
    labels = [label for block, label in EFFECT_OF_BLOCK.items() if keys.has(block)]
    model = keys.values.get("camera_model")
    if not keys.has("lens") and model in LENS_LABELS:
        labels.insert(0, LENS_LABELS[model])
    return "+".join(labels) or "pinhole"


def _split(keys: Keys) -> str:
    """Split of a frame that names none, from nerfstudio's lists."""
    path = keys.values.get("file_path")
    held = [keys.values.get(key) for key in ("test_filenames", "val_filenames")]
    listed = (names for names in held if isinstance(names, list))
    return "test" if any(path in names for names in listed) else "train"


def _demand_times(top: Keys, frames: list[Keys]) -> None:
    if frames and not any(frame.has("time") for frame in frames):
        if top.values.get("static") is not True:
            top.warn("no frame has a time: the capture is taken as static, at time 0.")
        return
    for frame in frames:
        frame.number("time", remedy="Give every frame its time, or none (a static capture).")


def _warn_splits(top: Keys, frames: list[Keys]) -> None:
    if any(key in top.values for key in ("test_filenames", "val_filenames", "train_filenames")):
        return
    lack = [frame.frame for frame in frames if not frame.has("split")]
    if lack:
        top.warn(
            f"{len(lack)} of {len(frames)} frames, first frame {lack[0]}, have no split: each is "
            "taken as train."
        )


def _warn_unknown(top: Keys, frames: list[Any]) -> None:
    for key in top.values:
        if key not in _SHARED | _FRAME | _TOP | _IGNORED:
            top.warn(f"the key {key} is unknown and ignored.{_meant(key, top.values)}")
    counts: dict[str, list[int]] = {}
    for k, frame in enumerate(frames):
        for key in frame if isinstance(frame, dict) else ():
            if key not in _SHARED | _FRAME | _IGNORED:
                counts.setdefault(key, []).append(k)
    for key, where in counts.items():
        more = f" (and in {len(where) - 1} more frames)" if len(where) > 1 else ""
        meant = _meant(key, {**top.values, **frames[where[0]]})
        Keys(top.file, {}, where[0]).warn(f"the key {key} is unknown and ignored{more}.{meant}")


def _meant(key: str, present: Mapping[str, Any]) -> str:
    """A question that names the known key that an unknown one is most like; empty if it is like
    none, or that one is present as well."""
    known = sorted(_SHARED | _FRAME | _TOP)
    alike = difflib.get_close_matches(key, known, n=1, cutoff=_ALIKE)
    return f" Did you mean {alike[0]}?" if alike and alike[0] not in present else ""


def read_document(path: Path) -> Keys:
    """The top level of a JSON file, which must list at least one frame.

    Raises:
        CaptureError: the file is no JSON object with frames.
        FileNotFoundError: the file does not exist.
    """
    top = Keys(path, json_object(path))
    frames = top.values.get("frames")
    if not isinstance(frames, list) or not frames:
        raise top.error("frames", "a list of at least one frame")
    within(path, "the frames", len(frames), "frames")
    return top


def json_content(path: Path) -> Any:
    """The content of a JSON file; CaptureError says what is malformed in it."""
    try:
        return read_json(path)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: the capture's JSON file does not exist.") from None
    except ValueError as error:
        raise CaptureError(str(error)) from None


def json_object(path: Path) -> dict[str, Any]:
    """The content of a JSON file that holds one object; CaptureError says what it holds instead."""
    content = json_content(path)
    if not isinstance(content, dict):
        raise CaptureError(
            f"{path}: the file must hold one JSON object, got {type(content).__name__}."
        )
    return content


def json_if_readable(path: Path) -> Any:
    """The content of a JSON file; None if it does not exist or is malformed."""
    try:
        return json_content(path) if path.is_file() else None
    except (CaptureError, OSError):
        return None
