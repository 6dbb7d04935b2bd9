"""How near to a camera the scene begins."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.capture.capture import Capture, View
from gaussray.io.plain_values import to_device


# Of the distance to the nearest other camera. A camera's body is smaller, and what is nearer to it
# hardly shows to two cameras.
_SHARE = 0.1


def with_clip_starts(capture: Capture, clip_start: float | None = None) -> Capture:
    """The capture with `Camera.clip_start` for all cameras or for none.

    Cameras that film together see one another. What they show of a camera is a body around its
    lens, through which it would see nothing: it begins to see outside of it. That is a tenth of the
    distance to the nearest other camera, for cameras that stand still in pictures of several times.

    Args:
        capture: the capture.
        clip_start: of all cameras, in scene units, whatever the files say; None is what the files
            say, and 0 for other cameras of such files, or else that tenth.
    """
    views = capture.all_views
    if clip_start is not None:
        clips = {view.camera_name: clip_start for view in views}
    elif any(view.camera.clip_start is not None for view in views):
        clips = {}
    else:
        clips = _from_distances(capture.views)
        if not clips:
            return capture

    made: dict[tuple[float, DTypeLike], Array] = {}

    def start(view: View) -> Array:
        """As an array, of which cameras share one: each is a transfer to the device."""
        key = clips.get(view.camera_name, 0.0), view.camera.time.dtype
        if key not in made:
            made[key] = to_device(*key)
        return made[key]

    def clipped(view: View) -> View:
        if clip_start is None and view.camera.clip_start is not None:
            return view
        camera = dataclasses.replace(view.camera, clip_start=start(view))
        return dataclasses.replace(view, camera=camera)

    return capture.with_views(lambda views: [clipped(view) for view in views])


def _from_distances(views: Sequence[View]) -> dict[str, float]:
    """For each camera that stands still a share of the distance to the nearest other one."""
    of_camera: dict[str, list[View]] = {}
    for view in views:
        of_camera.setdefault(view.camera_name, []).append(view)
    still = [name for name, shown in of_camera.items() if _stands_still(shown)]
    if len(still) < 2:
        return {}
    centre = np.concatenate([_path(of_camera[name][0]) for name in still])
    distance = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    return dict(zip(still, (_SHARE * distance.min(axis=1)).tolist(), strict=True))


def _stands_still(views: Sequence[View]) -> bool:
    """Whether the pictures of a camera are of several times and from one place."""
    one_place = len(_path(views[0])) == 1 and len({_path(view).tobytes() for view in views}) == 1
    return one_place and len({view.time for view in views}) > 1


def _path(view: View) -> Float[np.ndarray, "poses 3"]:
    return np.asarray(view.camera.trajectory.translation)
