"""Captures of Neural 3D Video (DyNeRF): `poses_bounds.npy` beside one video per camera."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.poses_bounds import POSES_FILE, camera_keys, read_poses_bounds
from gaussray.capture.formats.transforms import points_of, views_in_time, views_of
from gaussray.capture.videos import frame_path, is_video, read_video


HELD_OUT = "cam00"
# Starting points by 4DGaussians' name for these captures, and by its name for others.
_POINT_FILES = ("points3D_downsample2.ply", "points3d.ply")


def read_neural3d(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The frames of the videos `camNN.mp4`, whose order is that of the rows of `poses_bounds.npy`.

    The world's axes stay the file's own (`poses_bounds.camera_keys`). `cam00` is held out; frame i
    of n is at time i / n, as in 4DGaussians. Starting points come from points3D_downsample2.ply,
    else from points3d.ply, where there is one.

    Args:
        folder: the folder with `poses_bounds.npy` and the videos.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: rows and videos do not agree; the message says how.
        FileNotFoundError: poses_bounds.npy does not exist.
        OSError: a video is damaged.
    """
    folder = Path(folder)
    rows, paths = read_poses_bounds(folder / POSES_FILE), videos_of(folder)
    if len(rows) != len(paths):
        names = ", ".join(path.name for path in paths) or "none"
        raise CaptureError(
            f"{folder / POSES_FILE}: the rows must be as many as the videos camNN.mp4 beside it, "
            f"got {len(rows)} and {len(paths)} ({names}). Copy the missing videos, or remove the "
            "rows of cameras that have none."
        )
    videos = [read_video(path) for path in paths]
    for path, video in zip(paths, videos, strict=True):
        if video.frames != videos[0].frames:
            raise CaptureError(
                f"{path}: all videos must have as many frames, got {video.frames}, but "
                f"{videos[0].frames} in {paths[0].name}. Cut them to the same instants."
            )
    top = Keys(folder / POSES_FILE, {})
    keys = [
        camera_keys(top, k, rows[k], paths[k], (video.width, video.height))
        for k, video in enumerate(videos)
    ]
    views = []
    for view, path in zip(views_of(top, keys, dtype), paths, strict=True):
        view = dataclasses.replace(view, split="test" if path.stem == HELD_OUT else "train")
        views += views_in_time(view, [frame_path(path, i) for i in range(videos[0].frames)])
    points = points_of(top, _POINT_FILES)
    times = [view.time for view in views]
    return Capture(folder, views, {}, points, (min(times), max(times)), "normalised")


def videos_of(folder: Path) -> list[Path]:
    """The videos of a folder whose names begin with cam, in the order of their names."""
    names = sorted(path for path in folder.glob("cam*") if is_video(path) and path.is_file())
    return [Keys(folder / POSES_FILE, {"video": path.name}).inside("video") for path in names]
