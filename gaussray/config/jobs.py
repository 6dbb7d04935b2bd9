"""Makes render jobs from a configuration, or from samples of its distributions."""

import contextlib
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from omegaconf import OmegaConf

from gaussray.camera.imu import ImuOptions
from gaussray.camera.sensor.sensor import SensorOptions
from gaussray.capture.capture import View
from gaussray.config.compose import Configuration, Variations, compose_config
from gaussray.config.launch import launch_jobs
from gaussray.config.options import as_type, build_options
from gaussray.config.run_folder import begin_run_folder
from gaussray.config.yaml_files import to_plain
from gaussray.dataset.layouts import LAYOUT_LABELS, write_layout
from gaussray.dataset.manifest import FrameRecord
from gaussray.dataset.takes import MANIFEST, write_takes
from gaussray.io.safe.limits import Limits, limit
from gaussray.render.aov.labeller import check_labels
from gaussray.render.job import RenderJob
from gaussray.render.options import DatasetOptions, RenderOptions
from gaussray.render.randomize.distributions import read_distributions
from gaussray.render.randomize.generate import Distributions, MakeJob, generate_samples
from gaussray.render.randomize.options import FactoryOptions
from gaussray.render.rig import physical_units as physical, rig as rigs
from gaussray.render.rig.placed import placed_views
from gaussray.render.rig.used_keys import apply_implied_choices, check_used_keys
from gaussray.render.rig.validate import check_cameras
from gaussray.runtime.devices import DevicesOptions, begin, together
from gaussray.scene.formats.any_file import is_foreign, load
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.tracer.trace import TraceOptions


# Keys about progress and reports.
_REPORTING = ("quiet", "progress", "report")
# Keys that say where and by whom a sample is rendered: they are no parameters of the sample.
_NO_PARAMETERS = (
    *("preset", "out", "devices", "limits", "sample", "factory", "dataset", "imu"),
    *_REPORTING,
)
# Keys that may differ between the processes that work on one dataset.
_PER_PROCESS = (
    "out",
    "devices",
    "factory.shard",
    "factory.shards",
    "render.memory",
    *_REPORTING,
)
# The distribution of every seed of a randomised dataset. The seed of shake has single precision, to
# which the number of the camera is added.
_SEEDS = {"integer": [0, 2**31 - 1]}
_SHAKE_SEEDS = {"integer": [0, 2**23]}


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
    note: Callable[[str], Any] = lambda line: None,
) -> RenderJob:
    """The render job of a configuration.

    Args:
        cfg: A configuration of `gaussray render` or `gaussray view`.
        load: Reads the scene from its path; a cached function where many jobs share the scene.
        cameras: Reads the views from the paths of scene and capture, likewise.
        note: Gets a line about each choice that a key has switched on.

    Raises:
        ValueError: A value is impossible; the message names its key and its rule.
    """
    rig, notes = apply_implied_choices(rig_options(cfg))
    for line in notes:
        note(line)
    units = build_options(physical.PhysicalOptions, cfg.physical)
    sensor = build_options(SensorOptions, cfg.sensor)
    options, trace = (
        build_options(RenderOptions, cfg.render),
        build_options(TraceOptions, cfg.trace),
    )
    fps = as_type(float, cfg.fps, "fps")
    if not fps > 0:
        raise ValueError(f"fps must be above 0, got {fps}.")
    labels = as_type(tuple, to_plain(cfg.labels), "labels")
    check_labels(labels)
    scene = load(cfg.scene)
    views = chosen_views(cfg, scene, rig.camera, cameras)
    in_scene_units = physical.apply_units(rig, units)
    check_used_keys(in_scene_units)
    records = rigs.frame_records(
        views,
        options=in_scene_units,
        samples=options.samples,
        format=as_type(str, cfg.format, "format"),
    )
    physical.check_shape(units, (record.camera.film for record in records))
    check_cameras(in_scene_units, records)
    interval = frame_interval(views)
    labels = _possible_labels(labels, records, interval, note)
    info = physical.units_record(rig, units)
    dataset = DatasetOptions(sensor, labels, fps, info, interval)
    return RenderJob(scene, records, options, trace, dataset)


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
        cfg: The configuration.
        scene: The scene.
        camera: Options of the camera.
        cameras: Reads the views of a capture.
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


def generate_dataset(cfg: Configuration, overrides: Sequence[str]) -> str:
    """Render samples of the distributions in `sample`.

    It is this process's shard, or all shards through Hydra's launcher.

    Args:
        cfg: The configuration.
        overrides: Its words.

    Returns:
        A line about the result, for the user.
    """
    factory, out = build_options(FactoryOptions, cfg.factory), Path(cfg.out)
    layout, imu = as_type(str, cfg.dataset, "dataset"), build_options(ImuOptions, cfg.imu)
    if layout:
        cfg, overrides = _with_labels(cfg, overrides, layout)
    if factory.shards > 1:
        # All shards share one folder, also if it is named by the time.
        overrides = [*(word for word in overrides if not word.startswith("out=")), f"out={out}"]
        jobs = [
            [f"factory.shard={i}/{factory.shards}", "factory.shards=1"]
            for i in range(factory.shards)
        ]
        launch_jobs("render", overrides, jobs, functools.partial(render_shard, overrides))
        with contextlib.suppress(OSError):
            (out / "jobs").rmdir()  # which stays empty unless a cluster has left files
        missing = write_takes(out, factory.count)
    else:
        missing = render_shard(overrides, cfg)
    if missing:
        return f"{out}: {missing} of {factory.count} samples are left to other shards."
    if layout:
        frames = write_layout(out, out / layout, layout, imu=imu)
        return f"{out / layout}: {factory.count} samples, {frames} frames in the layout {layout}."
    return f"{out / MANIFEST}: {factory.count} samples."


def _with_labels(
    cfg: Configuration, overrides: Sequence[str], layout: str
) -> tuple[Configuration, Sequence[str]]:
    """The configuration and its words with the labels that a layout needs."""
    if layout not in LAYOUT_LABELS:
        known = ", ".join(LAYOUT_LABELS)
        raise ValueError(f"dataset must be empty or one of {known}, got {layout!r}.")
    if cfg.format != "png":
        raise ValueError(f"format must be png with dataset={layout}, got {cfg.format!r}.")
    labels = list(dict.fromkeys([*to_plain(cfg.labels), *LAYOUT_LABELS[layout]]))
    overrides = [*overrides, f"labels=[{','.join(labels)}]"]
    return compose_config("render", overrides), overrides


def render_shard(overrides: Sequence[str], cfg: Configuration) -> int:
    """Render the samples of one shard.

    Args:
        overrides: Words of the configuration.
        cfg: The configuration.

    Returns:
        The number of samples, of all shards, that are still missing.
    """
    limit(build_options(Limits, cfg.limits))
    devices = begin(build_options(DevicesOptions, cfg.devices))
    if together():
        raise ValueError(
            "devices.hosts must be 1 with factory.count: processes share the samples by "
            "factory.shard."
        )
    source = sample_source(cfg, overrides)
    out = begin_run_folder(cfg, without=_PER_PROCESS, part=source.options.shard)
    return generate_samples(
        out,
        source.distributions,
        source.make_job,
        options=source.options,
        devices=devices,
        quiet=cfg.quiet,
    )


class SampleSource(NamedTuple):
    """What the samples of a configuration are drawn from: distributions by their keys, the function
    from drawn values to a job, and the options of the draw."""

    distributions: Distributions
    make_job: MakeJob
    options: FactoryOptions


def sample_source(cfg: Configuration, overrides: Sequence[str]) -> SampleSource:
    """The distributions and jobs of a configuration of `gaussray render`.

    The scene and the cameras are read once for all samples.

    Args:
        cfg: the composed configuration, with the distributions in its `sample`.
        overrides: words that it was composed from; each sample adds its drawn values to them.
    """
    variations = Variations("render", overrides)
    read, cameras = functools.lru_cache(2)(load), functools.lru_cache(2)(rigs.load_views)

    def make_job(values: Mapping[str, Any]) -> tuple[dict[str, Any], RenderJob]:
        varied = variations.with_values(values)
        parameters = {k: v for k, v in to_plain(varied).items() if k not in _NO_PARAMETERS}
        # Pictures do not depend on it: a dataset that ran out of memory continues with less.
        del parameters["render"]["memory"]
        return parameters, render_job(varied, read, cameras)

    return SampleSource(
        all_distributions(cfg, functools.partial(cameras, cfg.scene, cfg.cameras)),
        make_job,
        build_options(FactoryOptions, cfg.factory),
    )


def all_distributions(
    cfg: Configuration, views: Callable[[], Sequence[View]] = tuple
) -> dict[str, dict[str, Any]]:
    """The distributions from which samples are drawn, by key.

    They are those in `sample`, one for every seed of the configuration (two samples must not have
    the same noise), and those of the camera and the times of `factory.frames` successive frames.

    Args:
        cfg: a configuration of `gaussray render`.
        views: reads the capture's views, whose cameras and times are drawn; called only if these
            are to be drawn. Without views they are not.
    """
    seeds = {
        f"{group}.{key}": _SHAKE_SEEDS if key == "shake_seed" else _SEEDS
        for group, node in cfg.items()
        if OmegaConf.is_dict(node) and group not in _NO_PARAMETERS
        for key in node
        if str(key).endswith("seed")
    }
    drawn = read_distributions(to_plain(cfg.get("sample") or {}))
    return seeds | _frame_distributions(cfg, drawn, views) | drawn


def _frame_distributions(
    cfg: Configuration, drawn: Mapping[str, Any], views: Callable[[], Sequence[View]]
) -> dict[str, dict[str, Any]]:
    """Distributions of the camera and of the times of a sample's frames, unless these are chosen
    otherwise."""
    count, camera = cfg.factory.frames, to_plain(cfg.camera)
    keys = ("trajectory", "trajectory.kind", "camera", "camera.kind")
    moved = cfg.trajectory.kind != "keep" or camera.get("kind", "capture") != "capture"
    if not count or moved or any(key in drawn for key in keys):
        return {}
    splits = drawn.get("camera.split", {}).get("choice", [camera["split"]])
    times: dict[str, set[float]] = {}
    for view in views():
        name = view.camera_name
        if name in camera["names"] if camera["names"] else view.split in splits:
            times.setdefault(name, set()).add(float(view.time))
    if not times:
        return {}
    common = sorted(camera["times"] or set.intersection(*times.values()))
    if not common:
        return {}
    rows = [common[i : i + count] for i in range(max(len(common) - count, 0) + 1)]
    return {
        "camera.names": {"choice": [[name] for name in times]},
        "camera.times": {"choice": rows},
    }
