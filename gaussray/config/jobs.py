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
    in_scene_units = physical.apply_units(rig, units)
    check_used_keys(in_scene_units)
    focus_meter = meter(scene, trace)
    records = rigs.frame_records(
        views,
        options=in_scene_units,
        samples=options.samples,
        format=as_type(str, cfg.format, "format"),
        measure=focus_meter.subject_distance,
    )
    physical.check_shape(units, (record.camera.film for record in records))
    check_cameras(in_scene_units, records)
    _note_of_times(scene, records, tell)
    if note is not None and in_scene_units.aperture.radius:
        note_depth_of_field(in_scene_units.aperture, records[0].camera, options, focus_meter, note)
    interval = frame_interval(views)
    labels = _possible_labels(labels, records, interval, tell)
    info = physical.units_record(rig, units)
    dataset = DatasetOptions(sensor, labels, fps, info, interval)
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


def _note_of_times(
    scene: Scene | Clip, records: Sequence[FrameRecord], note: Callable[[str], Any]
) -> None:
    """Say how many pictures are exposed far outside of the scene's times, where nothing moves."""
    ranges = np.array([np.asarray(segment.time_range) for segment in segments_of(scene)])
    begin, end = float(ranges.min()), float(ranges.max())
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


def _possible_labels(
    labels: Sequence[str],
    records: Sequence[FrameRecord],
    interval: float,
    note: Callable[[str], Any],
) -> Sequence[str]:
    """The labels without flow, if no frame has a neighbour in time."""
    flow = [name for name in labels if name.startswith("flow_")]
    times = {(record.camera_name, float(record.camera.time)) for record in records}
    lone = len(times) == len({name for name, _ in times})
    if not (flow and lone):
        return labels
    if interval > 0:
        note(
            f"{', '.join(flow)}: every camera has one frame, so flow leads to the capture's next "
            f"frame, {interval:g} in time away."
        )
        return labels
    note(f"labels: without {', '.join(flow)}, because there is one time and no other frame.")
    return [name for name in labels if name not in flow]


def frame_interval(views: Sequence[View]) -> float:
    """The least time between two frames of a capture; 0 if all have one time."""
    times = np.unique([view.time for view in views])
    return float(np.min(np.diff(times))) if len(times) > 1 else 0.0


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
