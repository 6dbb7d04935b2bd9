"""Camera paths of the viewer: keyframes, the motion through them, a file for `gaussray render`."""

import json
import shlex
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.camera.placement import orbit
from gaussray.camera.trajectory import Trajectory, pose_at
from gaussray.geometry import BLENDER_AXES, rotation_matrix
from gaussray.io.atomic import atomic_path
from gaussray.viewer.preset import CONFIG
from gaussray.viewer.viewpoint import Viewpoint


PATH_FILE = "path.json"
# Keyframes of a turntable: the spline through them stays within 1e-4 of the circle's radius.
TURNTABLE_KEYFRAMES = 24


def path_trajectory(keyframes: Sequence[Viewpoint], times: tuple[float, float]) -> Trajectory:
    """The smooth motion through keyframes.

    Args:
        keyframes: at least two viewpoints; their own times do not count.
        times: scene times of the first and the last keyframe; the others are evenly between them.

    Raises:
        ValueError: There are fewer than two keyframes.
    """
    if len(keyframes) < 2:
        raise ValueError(f"a camera path must have at least two keyframes, got {len(keyframes)}.")
    first, last = times
    time = np.linspace(first, last if last > first else first + 1, len(keyframes))
    quat = np.array([keyframe.quat for keyframe in keyframes])
    position = np.array([keyframe.position for keyframe in keyframes])
    time, quat, position = (jnp.asarray(x, jnp.float32) for x in (time, quat, position))
    return Trajectory(time, quat, position, "spline")


def viewpoint_at(path: Trajectory, fraction: float) -> Viewpoint:
    """The viewpoint at a fraction of a path.

    Args:
        path: world_from_camera over the scene's time.
        fraction: fraction of the path's duration, from 0 to 1.
    """
    first, last = float(path.time[0]), float(path.time[-1])
    return _viewpoint_at_time(path, first + fraction * (last - first))


def _viewpoint_at_time(path: Trajectory, time: float) -> Viewpoint:
    pose = jax.device_get(pose_at(path, jnp.asarray(time, jnp.float32)))
    quat, position = (tuple(float(x) for x in part) for part in (pose.quat, pose.translation))
    return Viewpoint(quat, position, time)  # type: ignore[arg-type]


def turntable(
    viewpoint: Viewpoint, target: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> list[Viewpoint]:
    """Keyframes of one turn of the camera around a target.

    Args:
        viewpoint: first viewpoint.
        target: point that the camera looks at, world axes, scene units.
        up: direction of the axis of rotation through the target.

    Raises:
        ValueError: The direction of view is along `up`.
    """
    circle = orbit(viewpoint.position, target, up)
    times = np.linspace(0, 1, TURNTABLE_KEYFRAMES + 1)
    return [_viewpoint_at_time(circle, float(time)) for time in times]


def save_path(folder: Path, path: Trajectory) -> Path:
    """Write a path as JSON that `trajectory.file` reads: poses in OpenGL axes, by time.

    Args:
        folder: folder of the preset whose camera moves along the path.
        path: world_from_camera over the scene's time; its keyframes are written.

    Returns:
        Path of the file, `PATH_FILE` in the folder.
    """
    poses = []
    knots = jax.device_get((path.time, path.quat, path.translation))
    for time, quat, position in zip(*knots, strict=True):
        matrix = np.eye(4)
        matrix[:3, :3] = np.asarray(rotation_matrix(jnp.asarray(quat))) * np.array(BLENDER_AXES)
        matrix[:3, 3] = position
        poses.append({"time": float(time), "transform_matrix": matrix.tolist()})
    with atomic_path(folder / PATH_FILE) as partial:
        partial.write_text(json.dumps({"trajectory": poses}, indent=1) + "\n")
    return folder / PATH_FILE


def path_command(folder: Path, frames: int) -> str:
    """The command line that renders the preset of a folder along its path.

    Args:
        folder: folder with the preset and the path.
        frames: number of pictures, evenly spaced in time along the path.
    """
    words = [
        f"preset={folder / CONFIG}",
        "trajectory=path",
        f"trajectory.file={folder / PATH_FILE}",
        "trajectory.clock=file",
        "trajectory.interpolation=spline",
        f"trajectory.steps={frames}",
        f"out={folder / 'film'}",
    ]
    return f"gaussray render {shlex.join(words)}"
