"""Samples in the layout of Carla-RS: rolling and global shutters, and the camera's motion."""

from pathlib import Path

import numpy as np

from gaussray.camera.imu import ImuOptions, camera_velocity
from gaussray.dataset.camera_paths import path_of_frames
from gaussray.dataset.sample_files import SampleFiles
from gaussray.io.atomic import atomic_path


# Frames of a sequence that the loader reads.
CARLA_FRAMES = 10
_HEAD = "# Ground truth velocity in camera frame\n# wx, wy, wz, x, y, z\n"


def write_carla_rs(source: SampleFiles, out: Path, units: ImuOptions) -> int:
    """Write a sample as OUT/SAMPLE/0000_rs.png, 0000_gs_f.png, 0000_gs_m.png, ... and gt_vel.log.

    Args:
        source: the sample, with the labels global_first and global_middle.
        out: folder of the layout.
        units: scene units per metre and seconds per unit of time.

    Returns:
        The number of frames.
    """
    folder = out / source.name
    for i, frame in enumerate(source.frames[:CARLA_FRAMES]):
        source.copy(source.file(frame), folder / f"{i:04d}_rs.png")
        for label, short in (("global_first", "f"), ("global_middle", "m")):
            source.copy(source.file(frame, label), folder / f"{i:04d}_gs_{short}.png")
    values = " ".join(f"{x:.9g}" for x in _first_motion(source, units))
    with atomic_path(folder / "gt_vel.log") as partial:
        partial.write_text(f"{_HEAD}{values}\n", encoding="utf-8")
    return min(len(source.frames), CARLA_FRAMES)


def _first_motion(source: SampleFiles, units: ImuOptions) -> np.ndarray:
    """Turn rate (rad/s) and velocity (m/s) of the camera along its own axes (right, down, forward)
    when the first row of the first frame is exposed, or when its path begins if that is later."""
    path, frame = path_of_frames(source.frames), source.frames[0]
    first = np.min(frame.get("row_times", frame["time"]))
    turn_rate, velocity = camera_velocity(path, max(float(first), float(path.time[0])))
    seconds = units.seconds_per_unit
    return np.concatenate([turn_rate / seconds, velocity / (seconds * units.units_per_metre)])
