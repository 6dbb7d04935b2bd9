"""Writes manifests: JSON files that list every picture with its exact camera."""

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.focus_pull import FocusPull
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import BLENDER_AXES, rotation_matrix
from gaussray.io.atomic import atomic_path
from gaussray.io.json_numbers import json_numbers
from gaussray.runtime.stored_programs import KeptProgram


_FRAME_KEYS = ("file_path", "transform_matrix", "trajectory", "time", "camera", "split", "labels")


@dataclasses.dataclass(frozen=True, eq=False)
class FrameRecord:
    """A written picture and its camera.

    Args:
        file_path: the picture, relative to the manifest's folder.
        camera: the camera; its time is written.
        camera_name: name of the camera.
        split: train or test.
        effect: effect that the picture shows.
        samples: rays per pixel.
        mask_path: file of the mask.
        depth_file_path: file of the depth.
        labels: files of the labels, by kind.
        neighbours: cameras of the frames before and after it, for flow where it is the only frame
            of its camera; None where it names none. They are not written.
    """

    file_path: str
    camera: Camera
    camera_name: str
    split: str
    effect: str = "pinhole"
    samples: int | None = None
    mask_path: str | None = None
    depth_file_path: str | None = None
    labels: Mapping[str, str] | None = None
    neighbours: tuple[Camera | None, Camera | None] | None = None


class ManifestEntry(NamedTuple):
    """What a manifest says about a picture.

    Args:
        keys: all keys, also those that other pictures share.
        tables: the arrays that the keys name, by file name.
    """

    keys: dict[str, Any]
    tables: Mapping[str, np.ndarray]


# The manifest of a reconstruction: the capture's cameras, as refined.
CAMERAS_FILE = "cameras.json"
# Key of its `info`: sides of the pictures that the reconstruction fitted, over those of the
# capture.
FIT_SCALE = "fit_scale"


def write_manifest(
    path: Path | str,
    views: Sequence[FrameRecord],
    *,
    extra: Mapping[str, Any] | None = None,
    entries: Mapping[str, ManifestEntry] | None = None,
) -> None:
    """Write a manifest, from which the capture readers read the same cameras, bit for bit.

    Keys that all frames share are at the top level; each frame is one line. Tables of rays are
    written beside the manifest. All files are written atomically.

    Args:
        path: the JSON file.
        views: the pictures.
        extra: further top-level keys, such as `ply_file_path`, `time_unit`, or `info`, in which
            readers accept anything.
        entries: entries of pictures that have been made already (`manifest_entry`), by file.

    Raises:
        ValueError: there are no frames, a number is not finite, or `extra` has a key of frames.
    """
    path = Path(path)
    if not views:
        raise ValueError(f"{path}: a manifest must list at least one frame, got none.")
    made = entries or {}
    listed = [made.get(view.file_path) or manifest_entry(view) for view in views]
    frames = [entry.keys for entry in listed]
    first = frames[0]
    shared = {
        key: value
        for key, value in first.items()
        if key not in _FRAME_KEYS and all(key in frame and frame[key] == value for frame in frames)
    }
    clash = [key for key in extra or {} if key == "frames" or any(key in f for f in frames)]
    if clash:
        raise ValueError(f"{path}: extra must not hold the keys of frames, got {clash}.")
    top = {**shared, **(extra or {})}
    try:
        lines = [f" {json.dumps(k)}: {json.dumps(v, allow_nan=False)}," for k, v in top.items()]
        texts = [
            json.dumps({k: v for k, v in frame.items() if k not in shared}, allow_nan=False)
            for frame in frames
        ]
    except ValueError as error:
        raise ValueError(f"{path}: every number written must be finite, got {error}.") from error
    tables = {name: rays for entry in listed for name, rays in entry.tables.items()}
    for name, rays in tables.items():
        with atomic_path(path.parent / name) as partial:
            np.savez_compressed(partial, rays=rays)
    text = "\n".join(["{", *lines, ' "frames": [', "  " + ",\n  ".join(texts), " ]", "}", ""])
    with atomic_path(path) as partial:
        partial.write_text(text, encoding="utf-8")


def manifest_entry(view: FrameRecord) -> ManifestEntry:
    """The entry of a picture in a manifest.

    Args:
        view: the picture.

    Raises:
        ValueError: the split is neither train nor test.
    """
    camera = jax.device_get(view.camera)
    if view.split not in ("train", "test"):
        raise ValueError(f"split must be one of train, test, got {view.split!r}.")
    film, lens = camera.film, camera.lens.record()
    frame = {
        **{"file_path": view.file_path, "camera": view.camera_name, "split": view.split},
        **{"time": json_numbers(camera.time), "transform_matrix": camera_to_world(camera)},
        **{"w": film.width, "h": film.height},
        **lens.keys,
    }
    blocks = {
        "film": _film(film),
        "aperture": _aperture(camera.aperture),
        "shutter": _shutter(camera.shutter),
        "trajectory": _trajectory(camera.trajectory),
    }
    frame |= {key: block for key, block in blocks.items() if block is not None}
    if camera.clip_start is not None:
        frame["clip_start"] = json_numbers(camera.clip_start)
    if view.effect != "pinhole" or len(frame.keys() & {"lens", *blocks}):
        frame["effect"] = view.effect
    for key in ("samples", "mask_path", "depth_file_path", "labels"):
        if getattr(view, key) is not None:
            frame[key] = getattr(view, key)
    return ManifestEntry(frame, lens.tables)


def _film(film):
    default = Film(film.width, film.height)
    if film == default:
        return None
    return {"filter": film.filter, "filter_width": film.filter_width}


def _aperture(aperture):
    if float(aperture.radius) == 0:
        return None
    block = {
        "radius": json_numbers(aperture.radius),
        "focus_distance": _focus(aperture.focus_distance),
        "focus": aperture.focus,
        "blades": aperture.blades,
        "rotation": json_numbers(aperture.rotation),
        "ratio": json_numbers(aperture.ratio),
    }
    if aperture.rim is not None:
        block["rim"] = {key: json_numbers(x) for key, x in vars(aperture.rim).items()}
    return block


def _focus(distance):
    if not isinstance(distance, FocusPull):
        return _finite_or_text(json_numbers(distance))
    distances = [_finite_or_text(x) for x in json_numbers(distance.distance)]
    return {"time": json_numbers(distance.time), "distance": distances, "ease": distance.ease}


def _finite_or_text(distance):
    return "infinity" if math.isinf(distance) else distance


def _shutter(shutter):
    values = {
        key: json_numbers(getattr(shutter, key)) for key in ("row_offset", "row_step", "exposure")
    }
    more = {key: getattr(shutter, key) for key in ("row_times", "trigger")}
    more = {key: json_numbers(x) for key, x in more.items() if x is not None}
    if not any(values.values()) and not more:
        return None
    return {**values, "direction": shutter.direction, **more}


def _trajectory(trajectory):
    shake = trajectory.shake
    if trajectory.time.shape[0] == 1 and shake is None:
        return None
    poses = zip(_rotations(jnp.asarray(trajectory.quat)), trajectory.translation, strict=True)
    matrices = [_matrix(*pose) for pose in poses]
    times = json_numbers(trajectory.time)
    entries = [
        {"time": time, "transform_matrix": matrix}
        for time, matrix in zip(times, matrices, strict=True)
    ]
    if trajectory.interpolation == "linear" and shake is None:
        return entries
    block = {"poses": entries, "interpolation": trajectory.interpolation}
    if shake is not None:
        block["shake"] = {key: json_numbers(value) for key, value in vars(shake).items()}
    return block


# Compiled, because single operations on these few numbers take a GPU milliseconds per frame.
_rotations = jax.jit(rotation_matrix)


def _pose_matrix(trajectory, time):
    pose = pose_at(trajectory, time)
    return rotation_matrix(pose.quat), pose.translation


_pose = KeptProgram(_pose_matrix, ())


def rotation_and_position(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Rotation matrix world_from_camera and position of a camera at its time, on the host."""
    path, time = jax.device_get((camera.trajectory, camera.time))
    return jax.device_get(_pose(path, time))


def camera_to_world(camera: Camera) -> list[list[float]]:
    """The 4x4 matrix from camera to world at the camera's time, in OpenGL axes, as manifests have
    it."""
    return _matrix(*rotation_and_position(camera))


def _matrix(rotation, translation):
    """Camera-to-world 4x4 in OpenGL axes."""
    rotation = np.asarray(rotation)
    rotation = rotation * np.asarray(BLENDER_AXES, rotation.dtype)[None]
    linear, position = json_numbers(rotation), json_numbers(translation)
    return [[*row, x] for row, x in zip(linear, position, strict=True)] + [[0.0, 0.0, 0.0, 1.0]]
