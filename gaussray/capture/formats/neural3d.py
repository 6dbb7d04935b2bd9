"""Captures of Neural 3D Video (DyNeRF): `poses_bounds.npy` beside one video per camera."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike, Float

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.paired import Capture, filmed, points_of, views_of
from gaussray.capture.videos import Video, frame_path, is_video, read_video
from gaussray.io.safe.arrays import read_npy


POSES_FILE = "poses_bounds.npy"
HELD_OUT = "cam00"
# The points that 4DGaussians makes for these captures, and its name for those of others.
POINTS = ("points3D_downsample2.ply", "points3d.ply")


def read_neural3d(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The frames of `camNN.mp4`, the cameras by their names' order in `poses_bounds.npy`.

    A row is LLFF's: 3 x 5 numbers (axes down, right and backwards, place, height, width and focal
    length in pixels) and two distances, which are not used. Videos may be smaller or larger than
    that: the focal length is scaled by their width, and the axis meets their centre. The world's
    axes stay the file's own. `cam00` is held out; frame i of n is at time i / n, as in
    4DGaussians. Starting points come from points3D_downsample2.ply, else from points3d.ply;
    without them a reconstruction starts from random ones, with a warning.

    Raises CaptureError, FileNotFoundError or OSError, naming file, row and remedy.
    """
    folder = Path(folder)
    rows, paths = _rows(folder / POSES_FILE), videos_of(folder)
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
    keys = [_camera(top, k, rows[k], paths[k], video) for k, video in enumerate(videos)]
    views = []
    for view, path in zip(views_of(top, keys, dtype), paths, strict=True):
        views += filmed(view, [frame_path(path, i) for i in range(videos[0].frames)])
    points = points_of(top, POINTS)
    if points is None:
        top.warn(
            f"neither {' nor '.join(POINTS)} is beside it: a reconstruction starts from random "
            "points. Add a point cloud, e.g. of COLMAP, in the world of these poses."
        )
    times = [view.time for view in views]
    return Capture(folder, views, {}, points, (min(times), max(times)), "normalised")


def videos_of(folder: Path) -> list[Path]:
    """The videos of a folder that are called cam..., in the order of their names."""
    found = sorted(path for path in folder.glob("cam*") if is_video(path) and path.is_file())
    return [Keys(folder / POSES_FILE, {"video": path.name}).inside("video") for path in found]


def _rows(path: Path) -> Float[np.ndarray, "cameras 17"]:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: the file with the cameras' poses does not exist.")
    try:
        rows = read_npy(path)
    except ValueError as error:
        raise CaptureError(f"{path}: the file must be a NumPy array: {error}") from None
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind != "f":
        raise CaptureError(
            f"{path}: the array must be real numbers [cameras, 17], got {rows.dtype} "
            f"{list(rows.shape)}. Each row is a 3 x 5 matrix of LLFF, near and far."
        )
    return np.array(rows, np.float64)


def _camera(top: Keys, k: int, row: np.ndarray, path: Path, video: Video) -> Keys:
    """What a frame of JSON would say of the camera."""
    matrix = row[:15].reshape(3, 5)
    down, right, back, place = matrix[:, :4].T
    name = f"row {k} ({path.name})"
    pose = Keys(top.file, {name: np.stack([right, -down, back, place], axis=1)}).pose(name)
    height, width, focal = matrix[:, 4]
    if not (np.isfinite(matrix[:, 4]).all() and (matrix[:, 4] > 0).all()):
        raise CaptureError(
            f"{top.file}: {name} must hold a height, width and focal length above 0, got "
            f"{matrix[:, 4].tolist()}."
        )
    if abs(video.height - height * video.width / width) > 1:
        raise CaptureError(
            f"{path}: the video must have the shape of {width:g} x {height:g} that {POSES_FILE} "
            f"names, got {video.width} x {video.height}. Scale the video without cropping it."
        )
    focal *= video.width / width
    return Keys(
        top.file,
        {
            **{"file_path": path.name, "camera": path.stem, "time": 0.0},
            **{"transform_matrix": pose, "split": "test" if path.stem == HELD_OUT else "train"},
            **{"w": video.width, "h": video.height, "fl_x": focal, "fl_y": focal},
            **{"cx": video.width / 2, "cy": video.height / 2},
        },
        k,
    )
