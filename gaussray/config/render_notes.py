"""Tells which cameras, sizes, times and flow a render job has that nobody chose."""

from collections.abc import Callable, Sequence
from typing import Any

from gaussray.camera.shutter import time_window
from gaussray.capture.capture import View
from gaussray.dataset.manifest import FrameRecord
from gaussray.render.rig.placed import CameraOptions


# Rows of the last picture may be read after the last time: by more than this share of all times, a
# picture is told to be outside.
_FAR = 0.1


def note_cameras(views: Sequence[View], camera: CameraOptions, note: Callable[[str], Any]) -> None:
    """Say which cameras are rendered where none of those that the default asks for is there.

    Args:
        views: the views of the capture.
        camera: which of them were asked for.
        note: gets the line.
    """
    held_out = any(view.split == "test" for view in views)
    if camera.kind == "capture" and camera.split == "test" and not camera.names and not held_out:
        names = list(dict.fromkeys(view.camera_name for view in views))
        listed = ", ".join(names) if len(names) < 4 else f"{names[0]} to {names[-1]}"
        note(
            f"No camera is held out, so all {len(names)} are rendered ({listed}); "
            "camera.names=[CAMERA] chooses some."
        )


def note_size(views: Sequence[View], scale: float, note: Callable[[str], Any]) -> None:
    """Say that pictures are smaller than the capture's where the fit saw smaller ones.

    Args:
        views: the views to render, of the size that the fit saw.
        scale: their sides over those of the capture (`FittedCameras.scale`).
        note: gets the line.
    """
    if scale < 1 and views:
        note(
            f"Pictures are {views[0].width} x {views[0].height}, as the fit saw them ({scale:.2g} "
            "of the capture's sides); film.size=[WIDTH,HEIGHT] sets another size."
        )


def note_times(
    span: tuple[float, float], records: Sequence[FrameRecord], note: Callable[[str], Any]
) -> None:
    """Say how many pictures are exposed far outside of the scene's times, where nothing moves.

    Args:
        span: first and last time of the scene.
        records: the pictures.
        note: gets the line.
    """
    begin, end = span
    windows: dict[int, tuple[float, float]] = {}
    outside = 0
    for camera in (record.camera for record in records):
        key = id(camera.shutter)
        if key not in windows:
            windows[key] = time_window(camera.shutter, (camera.film.width, camera.film.height))
        first, last = (float(camera.time) + moment for moment in windows[key])
        outside += max(begin - first, last - end) > _FAR * (end - begin)
    if outside and end > begin:
        note(
            f"{outside} of {len(records)} pictures are exposed far outside of the scene's times, "
            f"{begin:g} to {end:g}, where nothing moves. Times are in the capture's unit; "
            "physical.* takes milliseconds."
        )


def note_flow(
    labels: Sequence[str],
    records: Sequence[FrameRecord],
    views: Sequence[View],
    note: Callable[[str], Any],
) -> None:
    """Say where flow leads from the only frames of their cameras, and which have none.

    Args:
        labels: the labels of flow: flow_forward, flow_backward.
        records: the pictures.
        views: the views of the capture.
        note: gets the lines.
    """
    lone = [record for record in records if record.neighbours is not None]
    of_capture = {view.camera_name for view in views}
    owner = "that camera" if all(r.camera_name in of_capture for r in lone) else "its first camera"
    for label in labels:
        side, which = (1, "next") if label == "flow_forward" else (0, "previous")
        steps, without = dict[str, list[str]](), list[str]()
        for record in lone:
            other = (record.neighbours or (None, None))[side]
            if other is None:
                without.append(record.camera_name)
                continue
            step = f"{abs(float(other.time) - float(record.camera.time)):.4g}"
            steps.setdefault(step, []).append(record.camera_name)
        for step, names in steps.items():
            note(
                f"{label} of the only frame of {_first_of_many(names)} leads to the capture's "
                f"{which} frame of {owner}, {step} in time away."
            )
        if without:
            note(
                f"{label} of the only frame of {_first_of_many(without)} is NaN: the capture has "
                f"no {which} frame of {owner} within the scene's times."
            )


def _first_of_many(names: Sequence[str]) -> str:
    """Few names, or the first of many and how many others there are."""
    return ", ".join(names) if len(names) < 4 else f"{names[0]} and {len(names) - 1} others"
