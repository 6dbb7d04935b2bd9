"""Pictures of cameras that move, each with a camera-to-world matrix in OpenCV's axes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, DTypeLike, Float

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.completion import completed
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.poses import opengl_pose
from gaussray.capture.formats.time_order import check_later
from gaussray.capture.formats.transforms import points_of, views_of
from gaussray.io.safe.limits import within


# In seconds: a picture has a pose if one of the trajectory is at most so far from it (as TUM's
# associate.py), which is interpolated if its neighbours are at most so far from each other.
NEAREST, BRIDGED = 0.02, 0.1
# The farthest position. Its square is beyond single precision, the position itself is not.
_FAR = 1e30
# The least of a quaternion's length.
_LEAST = 1e-30
# Times since 1970 are in nanoseconds or microseconds if the latest is later than these.
_NANOSECONDS, _MICROSECONDS = 1e17, 1e14


class PosedPicture(NamedTuple):
    """A picture with its camera.

    Args:
        path: the picture, relative to the capture's folder.
        camera: name of the camera, which may have other pictures.
        time: its time.
        lens: keys of its lens, as in a transforms.json.
        source: the line or file of its pose, for messages.
        pose: camera to world, of a camera with OpenCV's axes; None if it has none. A matrix that is
            not finite, or 0, is none either: so do SLAM programs mark that they lost the way.
    """

    path: str
    camera: str
    time: float
    lens: Mapping[str, Any]
    source: Keys
    pose: Float[np.ndarray, "rows 4"] | None


def posed_capture(
    top: Keys, pictures: Sequence[PosedPicture], unit: str, dtype: DTypeLike
) -> Capture:
    """The capture of posed pictures, of which none is held out.

    Those without a pose are left out with one warning that counts them.

    Args:
        top: a file of the capture, which lies in its folder.
        pictures: the pictures, those of each camera in the order of their times.
        unit: unit of the times: `normalised` or `seconds`.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: none has a pose, a pose is not rigid, or two pictures of a camera have one
            time.
    """
    within(top.file, "the pictures", len(pictures), "frames")
    posed = [picture for picture in pictures if _is_valid(picture.pose)]
    if not posed:
        raise CaptureError(
            f"{top.file.parent}: at least one picture must have a pose, a finite matrix from the "
            f"camera to the world, got none of {len(pictures)}. Find poses with "
            f"`gaussray prepare`."
        )
    if len(posed) < len(pictures):
        first = next(picture for picture in pictures if not _is_valid(picture.pose))
        Keys(top.file.parent, {}).warn(
            f"{len(pictures) - len(posed)} of {len(pictures)} pictures, first {first.path}, have "
            "no valid pose: left out."
        )
    _check_times(top, posed)
    frames = completed(
        [
            Keys(
                top.file,
                {
                    **picture.lens,
                    **{"file_path": picture.path, "camera": picture.camera, "time": picture.time},
                    **{"split": "train", "transform_matrix": _opengl(picture)},
                },
                k,
                kind="picture",
            )
            for k, picture in enumerate(posed)
        ]
    )
    views = views_of(top, frames, dtype)
    times = [picture.time for picture in posed]
    span = (min(times), max(times))
    return Capture(top.file.parent, views, {}, points_of(top), span, unit)


def in_seconds(times: Float[np.ndarray, " poses"]) -> Float[np.ndarray, " poses"]:
    """Times in seconds, of a file that may count nanoseconds or microseconds since 1970."""
    latest = np.abs(times[np.isfinite(times)]).max(initial=0.0)
    return times * (1e-9 if latest > _NANOSECONDS else 1e-6 if latest > _MICROSECONDS else 1.0)


def by_time(folder: Path, times: Sequence[float], names: Sequence[str]) -> dict[float, str]:
    """The pictures of a camera by their times, in order.

    Args:
        folder: where they are, for the message.
        times: of each picture.
        names: theirs.

    Raises:
        CaptureError: two have one time.
    """
    pictures: dict[float, str] = {}
    for time, name in sorted(zip(times, names, strict=True)):
        if time in pictures:
            raise CaptureError(
                f"{folder}: each picture must have a time of its own, got {time:.17g} s for "
                f"{pictures[time]} and {name}. Remove one."
            )
        pictures[time] = name
    return pictures


def interpolated_poses(
    times: Float[np.ndarray, " poses"],
    quats: Float[np.ndarray, "poses 4"],
    places: Float[np.ndarray, "poses 3"],
    wanted: Float[np.ndarray, " pictures"],
) -> tuple[Float[np.ndarray, "pictures 4 4"], Bool[np.ndarray, " pictures"]]:
    """Poses of a trajectory at other times, and which of them there are: those at most `NEAREST`
    from one of the trajectory.

    Between two that are at most `BRIDGED` apart, the rotation is spherically and the place linearly
    interpolated; otherwise the nearest counts. Poses that are not finite are none.

    Args:
        times: times of the trajectory in seconds, in any order.
        quats: x, y, z, w, of any length above 0.
        places: where the camera is.
        wanted: other times in seconds.
    """
    from scipy.spatial.transform import Rotation, Slerp

    finite = np.isfinite(np.column_stack([times, quats, places])).all(axis=1)
    usable = np.flatnonzero(finite & (np.abs(quats).max(axis=1) > _LEAST))
    matrices = np.tile(np.eye(4), (len(wanted), 1, 1))
    _, first = np.unique(times[usable], return_index=True)
    usable = usable[first]
    if not len(usable):
        return matrices, np.zeros(len(wanted), bool)
    times, places = times[usable], places[usable]
    # Squares of the largest and of the smallest numbers would be infinite or 0.
    quats = quats[usable] / np.abs(quats[usable]).max(axis=1, keepdims=True)
    after = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(
        np.abs(times[before] - wanted) < np.abs(times[after] - wanted), before, after
    )
    apart = np.abs(times[nearest] - wanted)
    bridged = (times[after] - times[before] <= BRIDGED) & (wanted < times[after])
    at = np.where(bridged & (wanted > times[before]), wanted, times[nearest])
    if len(times) > 1:
        matrices[:, :3, :3] = Slerp(times, Rotation.from_quat(quats))(at).as_matrix()
    else:
        matrices[:, :3, :3] = Rotation.from_quat(quats).as_matrix()
    matrices[:, :3, 3] = np.stack([np.interp(at, times, axis) for axis in places.T], axis=1)
    return matrices, apart <= NEAREST


def _is_valid(pose: np.ndarray | None) -> bool:
    return pose is not None and bool(np.isfinite(pose).all() and np.any(pose[:3, :3]))


def _opengl(picture: PosedPicture) -> Float[np.ndarray, "4 4"]:
    """The pose for a transforms.json, checked as it was in the file."""
    source = picture.source
    assert picture.pose is not None
    keys = Keys(
        source.file, {"pose": picture.pose.tolist()}, source.frame, source.prefix, source.kind
    )
    matrix = keys.pose("pose")
    if np.abs(matrix[:, 3]).max() > _FAR:
        raise keys.error("pose", f"at most {_FAR:g} from the origin")
    return opengl_pose(matrix[:, :3], matrix[:, 3])


def _check_times(top: Keys, pictures: Sequence[PosedPicture]) -> None:
    """A camera is at one place at a time."""
    before: dict[str, float] = {}
    for picture in pictures:
        keys = Keys(top.file, {"time": picture.time}, prefix=f"{picture.path}: ")
        last = before.get(picture.camera, -np.inf)
        check_later(keys, "time", picture.time, last, "that of the picture before")
        before[picture.camera] = picture.time
