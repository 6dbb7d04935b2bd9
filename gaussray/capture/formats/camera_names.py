"""Names for cameras of frames that name none."""

import dataclasses
import json
from collections import Counter
from pathlib import PurePosixPath

from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.lenses import INTRINSICS


def with_camera_names(frames: list[Keys]) -> list[Keys]:
    """The frames, each with a `camera`.

    Frames without one are grouped by the folder of their pictures. A folder is one camera, named
    after the folder, if all its frames have one pose, or if its frames have distinct times (one
    camera that moves). Otherwise each pose is a camera of its own, named after its first picture.
    """
    folders: dict[str, list[int]] = {}
    for i, frame in enumerate(frames):
        if not frame.has("camera"):
            folders.setdefault(_path(frame).parent.as_posix(), []).append(i)
    names: dict[int, str] = {}
    separate: list[list[int]] = []
    for folder, members in folders.items():
        poses: dict[str, list[int]] = {}
        for i in members:
            poses.setdefault(_pose(frames[i]), []).append(i)
        if len(poses) == 1 or _distinct_times([frames[i] for i in members]):
            name = PurePosixPath(folder).name or "camera"
            names |= dict.fromkeys(members, name if name != ".." else "camera")
        else:
            separate += poses.values()
    stems = Counter(_path(frames[group[0]]).stem for group in separate)
    for group in separate:
        path = _path(frames[group[0]])
        parts = [part for part in path.with_suffix("").parts if part not in ("/", "..")]
        names |= dict.fromkeys(group, path.stem if stems[path.stem] == 1 else "_".join(parts))
    return [
        dataclasses.replace(frame, values={**frame.values, "camera": names[i]})
        if i in names
        else frame
        for i, frame in enumerate(frames)
    ]


def pose_and_lens(frame: Keys) -> str:
    """A text that is equal for frames of equal pose and lens."""
    keys = ("transform_matrix", "trajectory", *INTRINSICS, "lens")
    return json.dumps({key: frame.values.get(key) for key in keys}, sort_keys=True, default=str)


def _pose(frame: Keys) -> str:
    # A camera that moves by a recorded trajectory is one camera.
    key = "trajectory" if frame.has("trajectory") else "transform_matrix"
    return json.dumps(frame.values.get(key), default=str)


def _path(frame: Keys) -> PurePosixPath:
    return PurePosixPath(frame.text("file_path"))


def _distinct_times(frames: list[Keys]) -> bool:
    times = [frame.values.get("time") for frame in frames]
    known = all(isinstance(time, int | float) for time in times)
    return known and len(set(times)) == len(times)
