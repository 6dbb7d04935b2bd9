"""Makes render jobs from a configuration."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gaussray.camera.sensor.sensor import SensorOptions
from gaussray.capture.capture import View
from gaussray.config.compose import Configuration
from gaussray.config.focus_notes import note_depth_of_field
from gaussray.config.options import as_type, build_options
from gaussray.config.render_notes import (
    note_cameras,
    note_flow,
    note_size,
    note_times,
    note_trajectory,
)
from gaussray.config.yaml_files import to_plain
from gaussray.dataset.manifest import FrameRecord
from gaussray.render.aov.labeller import check_labels
from gaussray.render.focus import FocusMeter
from gaussray.render.job import RenderJob
from gaussray.render.options import DatasetOptions, RenderOptions
from gaussray.render.rig import physical_units as physical, rig as rigs
from gaussray.render.rig.fitted_cameras import fitted_cameras_file
from gaussray.render.rig.placed import placed_views
from gaussray.render.rig.used_keys import apply_implied_choices, check_used_keys
from gaussray.render.rig.validate import check_cameras
from gaussray.render.rig.view_files import load_views
from gaussray.scene.formats.any_file import is_foreign, load
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, segments_of
from gaussray.tracer.options import TraceOptions


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
    cameras: Callable = load_views,
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
    # What is measured or read for a note alone is left out where nobody gets it.
    noted = note is not None
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
    note_cameras(views, rig, tell)
    if cfg.cameras is None and not rig.film.size:
        note_size(views, tell)
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
    note_times(_time_range(scene), records, tell)
    if noted:
        note_trajectory(views, in_scene_units, _time_range(scene), records, tell)
    if noted and in_scene_units.aperture.radius:
        note_depth_of_field(in_scene_units.aperture, records[0].camera, options, focus_meter, tell)
    labels = _possible_labels(labels, records, views, tell)
    note_flow(_flow_labels(labels), records, views, tell)
    info = physical.units_record(rig, units)
    dataset = DatasetOptions(sensor, labels, fps, info)
    return RenderJob(scene, records, options, trace, dataset)


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
    fitted = not is_foreign(cfg.scene) and fitted_cameras_file(cfg.scene).is_file()
    return cfg.cameras is not None or fitted
