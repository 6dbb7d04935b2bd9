"""Makes render jobs from a configuration."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.camera.sensor.sensor import SensorOptions
from gaussray.camera.shutter import time_window
from gaussray.capture.capture import View
from gaussray.config.compose import Configuration
from gaussray.config.focus_notes import note_depth_of_field
from gaussray.config.options import as_type, build_options
from gaussray.config.yaml_files import to_plain
from gaussray.dataset.manifest import FrameRecord
from gaussray.render.aov.labeller import check_labels
from gaussray.render.focus import FocusMeter
from gaussray.render.job import RenderJob
from gaussray.render.options import DatasetOptions, RenderOptions
from gaussray.render.rig import physical_units as physical, rig as rigs
from gaussray.render.rig.placed import placed_views
from gaussray.render.rig.used_keys import apply_implied_choices, check_used_keys
from gaussray.render.rig.validate import check_cameras
from gaussray.scene.formats.any_file import is_foreign, load
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, segments_of
from gaussray.tracer.options import TraceOptions


# Rows of the last picture may be read after the last time: by more than this share of all times, a
# picture is told to be outside.
_FAR = 0.1


def rig_options(cfg: Configuration) -> rigs.RigOptions:
    """The cameras that a configuration asks for, without its `physical` values."""
    return rigs.RigOptions(
        camera=build_options(rigs.CameraOptions, cfg.camera),
        lens=build_options(rigs.LensOptions, cfg.lens),
        aperture=build_options(rigs.ApertureOptions, cfg.aperture),
        shutter=build_options(rigs.ShutterOptions, cfg.shutter),
        trajectory=build_options(rigs.TrajectoryOptions, cfg.trajectory),
        film=build_options(rigs.FilmOptions, cfg.film),
    )


def render_job(
    cfg: Configuration,
    load: Callable = load,
    cameras: Callable = rigs.load_views,
    note: Callable[[str], Any] | None = None,
    meter: Callable[[Scene | Clip, TraceOptions], FocusMeter] = FocusMeter,
) -> RenderJob:
    """The render job of a configuration.

    Args:
        cfg: a configuration of `gaussray render` or `gaussray view`.
        load: reads the scene from its path; a cached function where many jobs share the scene.
        cameras: reads the views from the paths of scene and capture, likewise.
        note: gets a line about each choice that a key has switched on, and about what looks wrong.
        meter: makes what measures focus distances in the scene; a cached function likewise.

    Raises:
        ValueError: A value is impossible; the message names its key and its rule.
    """
    rig, notes = apply_implied_choices(rig_options(cfg))
    tell = note or (lambda line: None)
    for line in notes:
        tell(line)
    units = build_options(physical.PhysicalOptions, cfg.physical)
    sensor = build_options(SensorOptions, cfg.sensor)
    options, trace = (
        build_options(RenderOptions, cfg.render),
        build_options(TraceOptions, cfg.trace),
    )
    fps = as_type(float, cfg.fps, "fps")
    if not fps > 0:
        raise ValueError(f"fps must be above 0, got {fps}.")
    labels = as_type(tuple, to_plain(cfg.get("labels", ())), "labels")
    check_labels(labels)
    scene = load(cfg.scene)
    views = chosen_views(cfg, scene, rig.camera, cameras)
    _note_of_cameras(views, rig.camera, tell)
    fitted = cfg.cameras is None and rig.camera.kind == "capture"
    if note is not None and fitted and not rig.film.size:
        _note_of_size(views, rigs.fit_scale(cfg.scene), tell)
    in_scene_units = physical.apply_units(rig, units)
    check_used_keys(in_scene_units)
    focus_meter = meter(scene, trace)
    records = rigs.frame_records(
        views,
        options=in_scene_units,
        samples=options.samples,
        format=as_type(str, cfg.format, "format"),
        measure=focus_meter.subject_distance,
        within=_time_range(scene) if _flow_labels(labels) else None,
    )
    physical.check_shape(units, (record.camera.film for record in records))
    check_cameras(in_scene_units, records)
    _note_of_times(scene, records, tell)
    if note is not None and in_scene_units.aperture.radius:
        note_depth_of_field(in_scene_units.aperture, records[0].camera, options, focus_meter, note)
    labels = _possible_labels(labels, records, views, tell)
    _note_of_flow(labels, records, views, tell)
    info = physical.units_record(rig, units)
    dataset = DatasetOptions(sensor, labels, fps, info)
    return RenderJob(scene, records, options, trace, dataset)


def _note_of_cameras(
    views: Sequence[View], camera: rigs.CameraOptions, note: Callable[[str], Any]
) -> None:
    """Say which cameras are rendered where none of those that the default asks for is there."""
    held_out = any(view.split == "test" for view in views)
    if camera.kind == "capture" and camera.split == "test" and not camera.names and not held_out:
        names = list(dict.fromkeys(view.camera_name for view in views))
        listed = ", ".join(names) if len(names) < 4 else f"{names[0]} to {names[-1]}"
        note(
            f"No camera is held out, so all {len(names)} are rendered ({listed}); "
            "camera.names=[CAMERA] chooses some."
        )


def _note_of_size(views: Sequence[View], scale: float, note: Callable[[str], Any]) -> None:
    """Say that pictures are smaller than the capture's where the fit saw smaller ones."""
    if scale < 1 and views:
        note(
            f"Pictures are {views[0].width} x {views[0].height}, as the fit saw them ({scale:.2g} "
            "of the capture's sides); film.size=[WIDTH,HEIGHT] sets another size."
        )


def _note_of_times(
    scene: Scene | Clip, records: Sequence[FrameRecord], note: Callable[[str], Any]
) -> None:
    """Say how many pictures are exposed far outside of the scene's times, where nothing moves."""
    begin, end = _time_range(scene)
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


def _time_range(scene: Scene | Clip) -> tuple[float, float]:
    """First and last time of a scene."""
    ranges = np.array([np.asarray(segment.time_range) for segment in segments_of(scene)])
    return float(ranges.min()), float(ranges.max())


def _flow_labels(labels: Sequence[str]) -> list[str]:
    return [name for name in labels if name.startswith("flow_")]


def _possible_labels(
    labels: Sequence[str],
    records: Sequence[FrameRecord],
    views: Sequence[View],
    note: Callable[[str], Any],
) -> Sequence[str]:
    """The labels without flow, if all frames and the views of the capture have one time."""
    flow = _flow_labels(labels)
    # Apart, because cameras have their times in single precision.
    of_records = {float(record.camera.time) for record in records}
    if not flow or len(of_records) > 1 or len({view.time for view in views}) > 1:
        return labels
    note(f"labels: without {', '.join(flow)}, because there is one time and no other frame.")
    return [name for name in labels if name not in flow]


def _note_of_flow(
    labels: Sequence[str],
    records: Sequence[FrameRecord],
    views: Sequence[View],
    note: Callable[[str], Any],
) -> None:
    """Say where flow leads from the only frames of their cameras, and which have none."""
    lone = [record for record in records if record.neighbours is not None]
    of_capture = {view.camera_name for view in views}
    owner = "that camera" if all(r.camera_name in of_capture for r in lone) else "its first camera"
    for label in _flow_labels(labels):
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
                f"{label} of the only frame of {_first(names)} leads to the capture's {which} "
                f"frame of {owner}, {step} in time away."
            )
        if without:
            note(
                f"{label} of the only frame of {_first(without)} is NaN: the capture has no "
                f"{which} frame of {owner} within the scene's times."
            )


def _first(names: Sequence[str]) -> str:
    """Few names, or the first of many and how many others there are."""
    return ", ".join(names) if len(names) < 4 else f"{names[0]} and {len(names) - 1} others"


def chosen_views(
    cfg: Configuration, scene: Scene | Clip, camera: rigs.CameraOptions, cameras: Callable
) -> list[View]:
    """The frames to render: of a capture's cameras, or of a camera that is placed in the scene.

    Args:
        cfg: the configuration.
        scene: the scene.
        camera: options of the camera.
        cameras: reads the views of a capture.
    """
    if camera.kind == "capture":
        return cameras(cfg.scene, cfg.cameras)
    views = cameras(cfg.scene, cfg.cameras) if has_cameras(cfg) else ()
    return placed_views(scene, camera, views)


def has_cameras(cfg: Configuration) -> bool:
    """Whether there is a capture: one that is named, or that of the reconstructed scene."""
    path = Path(cfg.scene)
    folder = path if path.is_dir() else path.parent
    has_cameras_file = not is_foreign(path) and (folder / "cameras.json").is_file()
    return cfg.cameras is not None or has_cameras_file
