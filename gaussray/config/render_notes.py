"""Tells which cameras, sizes, times and flow a render job has that nobody chose."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from gaussray.camera.lens import FocalLens
from gaussray.camera.shutter import time_window
from gaussray.capture.capture import View
from gaussray.capture.paths import lens_of_path
from gaussray.capture.view_file import shown_size
from gaussray.dataset.manifest import FrameRecord
from gaussray.render.rig.film import apply_film
from gaussray.render.rig.rig import RigOptions, choose_views
from gaussray.runtime.output import listed_names


# Rows of the last picture may be read after the last time: by more than this share of all times, a
# picture is told to be outside.
_FAR = 0.1
# Focal lengths that differ by this share are told: nobody sees less from one picture to the next.
_OTHER_LENS = 0.05


def note_cameras(views: Sequence[View], rig: RigOptions, note: Callable[[str], Any]) -> None:
    """Say which cameras are rendered, or passed by a ride, where none of those that the default
    asks for is there. A path of a file passes none.

    Args:
        views: the views of the capture.
        rig: which of them were asked for, and their trajectory.
        note: gets the line.
    """
    camera, ride = rig.camera, rig.trajectory.kind
    if ride == "path":
        return
    held_out = any(view.split == "test" for view in views)
    if camera.kind == "capture" and camera.split == "test" and not camera.names and not held_out:
        names = list(dict.fromkeys(view.camera_name for view in views))
        listed = ", ".join(names) if len(names) < 4 else f"{names[0]} to {names[-1]}"
        if ride == "between":
            note(
                f"No camera is held out, so the ride passes all {len(names)} ({listed}); "
                "camera.names=[CAMERA,CAMERA] chooses some and their order."
            )
            return
        note(
            f"No camera is held out, so all {len(names)} are rendered ({listed}); "
            "camera.names=[CAMERA] chooses some."
        )


def note_size(views: Sequence[View], note: Callable[[str], Any]) -> None:
    """Say that pictures are smaller than the capture's where the fit saw smaller ones.

    Args:
        views: the views to render, of the size that the fit saw.
        note: gets the line.
    """
    if not views or views[0].window is None:
        return
    view, box = views[0], views[0].window.box
    # A part of a picture is no smaller picture.
    scale = shown_size(view)[0] / box[2]
    if scale < 1:
        note(
            f"Pictures are {view.width} x {view.height}, as the fit saw them ({scale:.2g} of the "
            "capture's sides); film.size=[WIDTH,HEIGHT] sets another size."
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


def note_trajectory(
    views: Sequence[View],
    rig: RigOptions,
    span: tuple[float, float],
    records: Sequence[FrameRecord],
    note: Callable[[str], Any],
) -> None:
    """Say whose lens the pictures of a ride have where those of its cameras differ, which field of
    view of a file is not read, that a file's times are none of the scene's, and that cameras of one
    time shake each by itself.

    Args:
        views: the views of the capture.
        rig: cameras and trajectory.
        span: first and last time of the scene.
        records: the pictures.
        note: gets the lines.
    """
    own_lens = rig.lens.model == "keep"
    if own_lens and rig.camera.kind == "path":
        _note_path_lens("camera.file", rig.camera.file, note)
    if own_lens and rig.trajectory.kind == "path":
        _note_path_lens("trajectory.file", rig.trajectory.file, note)
    if rig.trajectory.clock == "file":
        _note_clock(rig.trajectory.file, span, records, note)
    if own_lens and rig.trajectory.kind == "between":
        _note_lens_of_ride(views, rig, records[0], note)
    if rig.trajectory.shake_degrees or rig.trajectory.shake_distance:
        _note_shakes(records, rig.trajectory.shake_seed, note)


def _note_path_lens(key: str, file: str, note: Callable[[str], Any]) -> None:
    """Say that the poses of a path file alone are read, and how its field of view is given."""
    lens = lens_of_path(file)
    if lens is None:
        return
    span = f"{lens.least:.4g}" + f" to {lens.largest:.4g}" * (lens.least < lens.largest)
    which = "the first pose's" if lens.least < lens.largest else "that"
    remedy = "lens=pinhole lens.fov=DEGREES gives all pictures a field of view from left to right."
    if lens.degrees is not None:
        remedy = (
            f"lens=pinhole lens.fov={lens.degrees:.4g} gives all pictures {which} field of view, "
            "in degrees from left to right."
        )
    note(
        f"{key}={file}: its poses alone are read, not its {lens.key} ({span} {lens.unit}); {remedy}"
    )


def _note_clock(
    file: str, span: tuple[float, float], records: Sequence[FrameRecord], note: Callable[[str], Any]
) -> None:
    """Say that no time of a path file is one of the scene's, where something moves in that."""
    begin, end = span
    first, last = (float(record.camera.time) for record in (records[0], records[-1]))
    if begin < end and (last < begin or first > end):
        note(
            f"trajectory.clock=file: the times of {file}, {first:.7g} to {last:.7g}, lie outside "
            f"of the scene's, {begin:.7g} to {end:.7g}. Choose trajectory.clock=span, or subtract "
            "the first time from all."
        )


def _note_lens_of_ride(
    views: Sequence[View], rig: RigOptions, record: FrameRecord, note: Callable[[str], Any]
) -> None:
    """Say that the lens of the first camera is that of all pictures, where others differ."""
    # As the ride does: of every camera its last view.
    passed = {view.camera_name: view.camera for _, view in choose_views(views, rig)}
    first, *others = passed
    lens, film = record.camera.lens, record.camera.film
    own, other = f"the lens of {first}", "others have other kinds of lenses"
    size = dataclasses.replace(rig.film, size=(film.width, film.height))
    lenses = [apply_film(passed[name], size).lens for name in others]
    if all(type(one) is type(lens) for one in lenses):
        if not isinstance(lens, FocalLens):
            return
        focal = [float(one.focal[0]) for one in lenses if isinstance(one, FocalLens)]
        length = float(lens.focal[0])
        if all(abs(f / length - 1) <= _OTHER_LENS for f in focal):
            return
        own += f", a focal length of {length:.0f} pixels"
        other = f"the others have {min(focal):.0f} to {max(focal):.0f} pixels at that size"
    note(
        f"All pictures of the ride have {own}; {other}. camera.names=[CAMERA,CAMERA] chooses the "
        "first."
    )


def _note_shakes(records: Sequence[FrameRecord], seed: int, note: Callable[[str], Any]) -> None:
    """Say that cameras with pictures at one time do not shake as one."""
    cameras: dict[float, set[str]] = {}
    for record in records:
        cameras.setdefault(float(record.camera.time), set()).add(record.camera_name)
    if any(len(names) > 1 for names in cameras.values()):
        last = seed + len({record.camera_name for record in records}) - 1
        note(
            f"Each camera shakes by itself (seeds {seed} to {last}), so those of one rig move "
            "against each other. For a rig that shakes as one, give each camera its poses "
            "over time: cameras=FILE with a `trajectory` of each frame."
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
                f"{label} of the only frame of {listed_names(names, most=3)} leads to the "
                f"capture's {which} frame of {owner}, {step} in time away."
            )
        if without:
            note(
                f"{label} of the only frame of {listed_names(without, most=3)} is NaN: the capture "
                f"has no {which} frame of {owner} within the scene's times."
            )
