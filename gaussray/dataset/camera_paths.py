"""The camera's path of a sample of a generated dataset, from the entries of its manifest."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gaussray.camera.shake import Shake
from gaussray.camera.trajectory import Trajectory
from gaussray.geometry import BLENDER_AXES


def path_of_frames(frames: Sequence[dict[str, Any]]) -> Trajectory:
    """The path that the frames of one camera share; where each has a pose of its own, the spline
    through these.

    Args:
        frames: entries of the manifest, in the order of time.

    Raises:
        ValueError: The frames have different trajectories, or two still cameras one time.
    """
    blocks = [frame.get("trajectory") for frame in frames]
    times = {frame["time"] for frame in frames}
    apart = blocks[0] is None and len(times) < len(frames)
    if apart or any(block != blocks[0] for block in blocks):
        raise ValueError(
            f"{frames[0]['file_path']}: the frames of a sample must share one trajectory. Choose "
            "one camera for each sample with camera.names, or leave dataset.frames above 0."
        )
    if blocks[0] is None:
        poses = [(frame["time"], frame["transform_matrix"]) for frame in frames]
        still = all(matrix == poses[0][1] for _, matrix in poses)
        return _trajectory(poses[:1] if still else poses, "spline", None)
    block = blocks[0] if isinstance(blocks[0], dict) else {"poses": blocks[0]}
    poses = [(pose["time"], pose["transform_matrix"]) for pose in block["poses"]]
    return _trajectory(poses, block.get("interpolation", "linear"), block.get("shake"))


def _trajectory(
    poses: Sequence[tuple[float, list[list[float]]]], interpolation: str, shake: Any
) -> Trajectory:
    from scipy.spatial.transform import Rotation

    matrices = np.array([matrix for _, matrix in poses], np.float64)
    turn = Rotation.from_matrix(matrices[:, :3, :3] * np.array(BLENDER_AXES)).as_quat()
    return Trajectory(
        np.array([time for time, _ in poses], np.float64),
        turn[:, [3, 0, 1, 2]],
        matrices[:, :3, 3],
        interpolation,
        None if shake is None else Shake(**shake),
    )
