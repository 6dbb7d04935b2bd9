"""What a capture's JSON files say of each picture: where it is, when and by what camera taken."""

import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path, PurePath
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.camera.camera import Camera
from gaussray.camera.trajectory import Trajectory
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.effects import (
    LABELS,
    aperture_of,
    film_of,
    quaternions,
    shutter_of,
    trajectory_of,
)
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.lenses import INTRINSICS, LENS_LABELS, lens_of
from gaussray.capture.frames import COLOR_SPACES
from gaussray.capture.points import Points, read_points
from gaussray.capture.window import Window
from gaussray.io.safe.files import read_json
from gaussray.io.safe.limits import within


PINHOLE_FILE = "transforms.json"
_SHARED = {*INTRINSICS, *LABELS, "film", "effect", "samples", "color_space", "time_unit"}
_FRAME = {
    *("file_path", "transform_matrix", "time", "camera", "split"),
    *("mask_path", "depth_file_path", "labels"),
}
_TOP = {"frames", "ply_file_path"}
# Keys of nerfstudio, instant-ngp and D-NeRF that say nothing of the pictures' cameras, and "info",
# in which a writer may leave whatever it likes.
_QUIET = {
    *("info", "aabb_scale", "camera_angle_x", "camera_angle_y", "applied_transform"),
    *("applied_scale", "orientation_override", "auto_scale_poses_override", "colmap_im_id"),
    *("sharpness", "rotation", "train_filenames", "val_filenames", "test_filenames"),
    *("fps", "scale", "offset", "n_frames"),
}


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """One picture of a capture and the camera that took it; alpha is seen over `background`.

    `image` is a file or a frame of a video (`videos.frame_path`), of which the camera's film is all
    or, smaller, what a `window` shows.
    """

    camera: Camera
    image: Path
    mask: Path | None
    depth: Path | None
    camera_name: str
    split: str
    time: float
    effect: str
    samples: int | None
    color_space: str
    background: str = "none"
    window: Window | None = None

    @property
    def width(self) -> int:
        return self.camera.film.width

    @property
    def height(self) -> int:
        return self.camera.film.height


@dataclasses.dataclass(frozen=True, eq=False)
class Capture:
    """A capture folder: pinhole views to learn from, the views of each effect, starting points.

    `time_range` spans the pinhole views (all views, if there are none).
    """

    folder: Path
    views: list[View]
    effects: dict[str, list[View]]
    points: Points | None
    time_range: tuple[float, float]
    time_unit: str


def read_capture(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """Everything a capture folder says; pictures are not opened (`frames.py` does)."""
    folder = Path(folder)
    files = effect_files(folder)
    if not files:
        raise CaptureError(
            f"{folder}: a capture must hold {PINHOLE_FILE} or another JSON file with frames, "
            "got none."
        )
    pinhole = [name for name, path in files.items() if path.name == PINHOLE_FILE]
    views = {name: read_views(path, dtype) for name, path in files.items()}
    main = document(files[pinhole[0]] if pinhole else next(iter(files.values())))
    points = points_of(main)
    listed = views.pop(pinhole[0]) if pinhole else []
    times = [view.time for view in listed or [view for some in views.values() for view in some]]
    unit = main.text("time_unit", "normalised")
    return Capture(folder, listed, views, points, (min(times), max(times)), unit)


def effect_files(folder: Path | str) -> dict[str, Path]:
    """Name of each effect -> its JSON file: all files of the folder that hold "frames".

    The name is the file's "effect", or "pinhole" for transforms.json and the stem of any
    other. JSON files without frames (reports) are no part of the capture.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: the capture folder does not exist.")
    found = {}
    paths = sorted(folder.glob("*.json"), key=lambda path: (path.name != PINHOLE_FILE, path.name))
    for path in paths:
        content = content_of(Keys(folder / PINHOLE_FILE, {"file": path.name}).inside("file"))
        if not isinstance(content, dict) or "frames" not in content:
            continue
        name = "pinhole" if path.name == PINHOLE_FILE else path.stem
        name = Keys(path, content).text("effect", name)
        if name in found:
            raise CaptureError(
                f"{path}: effect must be unique in a capture, got {name!r}, which "
                f"{found[name].name} has too. Rename one of them."
            )
        found[name] = path
    return found


def read_views(path: Path | str, dtype: DTypeLike = jnp.float32) -> list[View]:
    """Every frame of one JSON file, in its order. Paths are taken from the file's own folder."""
    top = document(Path(path))
    return views_of(top, frames_of(top), dtype)


def read_cameras(path: Path | str, dtype: DTypeLike = jnp.float32) -> list[View]:
    """The views of one JSON file for the sake of their cameras: its pictures may lie anywhere, and
    are not looked for."""
    top = document(Path(path))
    files = dict.fromkeys(("mask_path", "depth_file_path"))
    frames = []
    for frame in frames_of(top):
        named = PurePath(frame.text("file_path")).parts[-2:]
        name = "/".join(part for part in named if part not in ("/", "..")) or "picture"
        values = {**frame.values, **files, "file_path": name}
        frames.append(dataclasses.replace(frame, values=values))
    return views_of(top, frames, dtype)


def frames_of(top: Keys) -> list[Keys]:
    """The keys of each frame of a document, those of the top level among them."""
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
    """The views that the frames of a document describe, in their order."""
    _warn_assumed(top, frames)
    still = [None if frame.has("trajectory") else frame.pose() for frame in frames]
    poses = np.array([pose for pose in still if pose is not None]).reshape(-1, 3, 4)
    # Of NumPy, of which a row is a thousand times as cheap as one of JAX.
    turns = iter(np.asarray(quaternions(poses, dtype))) if len(poses) else iter(())
    made: dict[str, Any] = {}
    return [
        _view(frame, pose, None if pose is None else next(turns), made, dtype)
        for frame, pose in zip(frames, still, strict=True)
    ]


def filmed(view: View, images: Sequence[Path]) -> list[View]:
    """What a fixed camera films: picture i of n at time i / n, as 4DGaussians counts."""
    times = [i / len(images) for i in range(len(images))]
    dtype = view.camera.time.dtype
    return [
        dataclasses.replace(
            view,
            image=image,
            time=time,
            camera=dataclasses.replace(view.camera, time=jnp.array(time, dtype)),
        )
        for image, time in zip(images, times, strict=True)
    ]


def points_of(top: Keys, names: Sequence[str] = ("points3d.ply",)) -> Points | None:
    """Starting points: what `ply_file_path` names (it must exist), else the first of `names` that
    lies beside the document, else None."""
    named = top.path("ply_file_path")
    if named is not None:
        return read_points(named)
    found = [name for name in names if (top.file.parent / name).exists()]
    if len(found) > 1:
        top.warn(f"{found[0]} holds the starting points; {', '.join(found[1:])} is not read.")
    return read_points(top.file.parent / found[0]) if found else None


def _view(keys, pose, turn, made, dtype):
    # Frames share most of their camera: each part is built and checked once per distinct content.
    def part(name: str, names: tuple[str, ...], build: Callable):
        content = {key: keys.values.get(key) for key in names}
        label = name + json.dumps(content, sort_keys=True)
        if label not in made:
            try:
                made[label] = build()
            except CaptureError:
                raise
            except ValueError as error:  # the camera's own check, without the place
                raise CaptureError(f"{keys.where}: {error}") from error
        return made[label]

    time = keys.number("time", 0.0)
    if pose is None:
        trajectory = part("path", ("trajectory",), lambda: trajectory_of(keys, dtype))
    else:
        place = jnp.array(pose[None, :, 3], dtype)
        trajectory = Trajectory(jnp.array([0.0], dtype), jnp.array(turn[None]), place)
    camera = Camera(
        film=part("film", ("w", "h", "film"), lambda: film_of(keys)),
        lens=part("lens", (*INTRINSICS, "lens"), lambda: lens_of(keys, dtype)),
        aperture=part("aperture", ("aperture",), lambda: aperture_of(keys, dtype)),
        shutter=part("shutter", ("w", "h", "shutter"), lambda: shutter_of(keys, dtype)),
        trajectory=trajectory,
        time=jnp.array(time, dtype),
    )
    image = keys.inside("file_path")
    return View(
        camera=camera,
        image=image,
        mask=keys.path("mask_path"),
        depth=keys.path("depth_file_path"),
        camera_name=keys.text("camera", image.parent.name or "camera"),
        split=keys.choice("split", ("train", "test"), _split(keys)),
        time=time,
        effect=keys.text("effect", _label(keys)),
        samples=keys.count("samples") if keys.has("samples") else None,
        color_space=keys.choice("color_space", COLOR_SPACES, "srgb"),
    )


def _label(keys):
    """Effect of a frame that names none, from its blocks."""
    found = [label for block, label in LABELS.items() if keys.has(block)]
    model = keys.values.get("camera_model")
    if not keys.has("lens") and model in LENS_LABELS:
        found.insert(0, LENS_LABELS[model])
    return "+".join(found) or "pinhole"


def _split(keys):
    """Split of a frame that names none, from nerfstudio's lists."""
    path = keys.values.get("file_path")
    held = [keys.values.get(key) for key in ("test_filenames", "val_filenames")]
    listed = (names for names in held if isinstance(names, list))
    return "test" if any(path in names for names in listed) else "train"


def _warn_assumed(top, frames):
    if frames and not any(frame.has("time") for frame in frames):
        top.warn("no frame has a time: the capture is taken as static, at time 0.")
    else:
        for frame in frames:
            frame.number("time", remedy="Give every frame its time, or none (a static capture).")
    defaults = {"camera": "the folder of its picture"}
    if not any(key in top.values for key in ("test_filenames", "val_filenames", "train_filenames")):
        defaults["split"] = "train"
    for key, value in defaults.items():
        lack = [frame.frame for frame in frames if not frame.has(key)]
        if lack:
            top.warn(
                f"{len(lack)} of {len(frames)} frames, first frame {lack[0]}, have no {key}: "
                f"each is taken as {value}."
            )


def _warn_unknown(top, frames):
    for key in top.values:
        if key not in _SHARED | _FRAME | _TOP | _QUIET:
            top.warn(f"the key {key} is unknown and ignored.")
    counts: dict[str, list[int]] = {}
    for k, frame in enumerate(frames):
        for key in frame if isinstance(frame, dict) else ():
            if key not in _SHARED | _FRAME | _QUIET:
                counts.setdefault(key, []).append(k)
    for key, where in counts.items():
        more = f" (and in {len(where) - 1} more frames)" if len(where) > 1 else ""
        Keys(top.file, {}, where[0]).warn(f"the key {key} is unknown and ignored{more}.")


def document(path: Path) -> Keys:
    """The top level of a JSON file, which must list at least one frame."""
    content = content_of(path)
    if not isinstance(content, dict):
        raise CaptureError(
            f"{path}: the file must hold one JSON object, got {type(content).__name__}."
        )
    top = Keys(path, content)
    frames = content.get("frames")
    if not isinstance(frames, list) or not frames:
        raise top.error("frames", "a list of at least one frame")
    within(path, "the frames", len(frames), "frames")
    return top


def content_of(path: Path) -> Any:
    """What a JSON file holds."""
    try:
        return read_json(path)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: the capture's JSON file does not exist.") from None
    except ValueError as error:
        raise CaptureError(str(error)) from None
