"""Captures of smoke as PINF and HyFluid have them (ScalarFlow): `info.json` and a video per camera.

Chu et al. 2022; Yu et al. 2023.
"""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.formats.completion import completed
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.transforms import json_content, json_if_readable, points_of, views_of
from gaussray.capture.videos import Video, read_video
from gaussray.io.safe.limits import within


INFO_FILE = "info.json"
# The list of videos of each split. The validation split is neither trained on nor scored.
_LISTS = {"train": "train_videos", "test": "test_videos"}
_VALIDATION = "val_videos"


def is_pinf(folder: Path) -> bool:
    """Whether a folder holds an info.json that lists training videos."""
    content = json_if_readable(folder / INFO_FILE)
    return isinstance(content, dict) and _LISTS["train"] in content


def read_pinf(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The frames of the videos that `train_videos` of `info.json` lists, and held out, those of
    `test_videos`.

    Each video has a `file_name`, `camera_angle_x` in radians, and the camera's `transform_matrix`
    (camera to world, OpenGL axes), or a `transform_matrix_list` with one for each frame. Its first
    `frame_num` frames are read, all without; frame i of n is at time i / n. The optical axis meets
    the picture's centre. Starting points come from points3d.ply, if it exists.

    Args:
        folder: the folder with `info.json` and the videos.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format; the message names file, video and key.
        FileNotFoundError: info.json or a video does not exist.
        OSError: a video is damaged.
    """
    folder = Path(folder)
    content = json_content(folder / INFO_FILE)
    top = Keys(folder / INFO_FILE, content if isinstance(content, dict) else {})
    listed = {split: _videos(top, key) for split, key in _LISTS.items()}
    if not listed["train"]:
        raise top.error(_LISTS["train"], "a list of at least one video")
    if top.has(_VALIDATION):
        top.warn(f"{_VALIDATION} are not read: only train_videos and test_videos are used.")
    frames: list[Keys] = []
    for split, videos in listed.items():
        for video in videos:
            frames += _frames(video, split, len(frames))
    within(top.file, "the frames of all videos", len(frames), "frames")
    views = views_of(top, frames, dtype)
    times = [view.time for view in views]
    return Capture(folder, views, {}, points_of(top), (min(times), max(times)), "normalised")


def _videos(top: Keys, key: str) -> list[Keys]:
    """The keys of each video of a list."""
    content = top.values.get(key) or []
    if not isinstance(content, list) or not all(isinstance(video, dict) for video in content):
        raise top.error(key, "a list of videos, each a JSON object")
    return [Keys(top.file, video, prefix=f"{key}[{k}].") for k, video in enumerate(content)]


def _frames(video: Keys, split: str, first: int) -> list[Keys]:
    """The keys of each frame of a video as those of a frame in a transforms.json.

    Args:
        video: keys of the video.
        split: train or test.
        first: how many frames come before.
    """
    path = video.inside("file_name")
    film = read_video(path)
    count = video.count("frame_num", film.frames)
    if count > film.frames:
        raise video.error("frame_num", f"at most {film.frames}, as {path.name} has frames")
    matrices = video.values.get("transform_matrix_list")
    if matrices is None:
        matrices = [video.pose()] * count
    elif not isinstance(matrices, list) or len(matrices) < count:
        raise video.error("transform_matrix_list", f"a list of {count} matrices, one for a frame")
    lens = _lens(video, film)
    name = video.text("file_name")
    return [
        Keys(
            video.file,
            {
                **{"file_path": f"{name}/{i:04d}", "camera": path.stem, "split": split},
                **{"time": i / count, "transform_matrix": matrices[i], **lens},
            },
            first + i,
        )
        for i in range(count)
    ]


def _lens(video: Keys, film: Video) -> dict[str, float]:
    """The pinhole of a video, for frames of its own size."""
    video.number("camera_angle_x")
    if video.has("camera_hw"):
        height, width = video.vector("camera_hw", 2)
        if not (width > 0 and abs(film.height - height * film.width / width) <= 1):
            raise video.error(
                "camera_hw",
                f"height and width of the video's shape, which is {film.height} x {film.width}",
                "Scale videos without cropping.",
            )
    size = {"w": film.width, "h": film.height}
    (whole,) = completed([dataclasses.replace(video, values={**video.values, **size})])
    return {key: whole.values[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
