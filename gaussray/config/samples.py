"""Renders samples of a configuration's distributions: a randomised dataset."""

import contextlib
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import OmegaConf

from gaussray.camera.imu import ImuOptions
from gaussray.capture.capture import View
from gaussray.config.compose import Configuration, Variations, compose_config
from gaussray.config.focus_notes import chosen_lengths
from gaussray.config.jobs import has_cameras, render_job
from gaussray.config.launch import launch_jobs
from gaussray.config.options import build_options
from gaussray.config.run_folder import begin_run_folder
from gaussray.config.schema import choice_keys, choices, groups, keys
from gaussray.config.suggest import did_you_mean
from gaussray.config.yaml_files import to_plain
from gaussray.dataset.layouts import LAYOUT_LABELS, check_layout, write_layout
from gaussray.dataset.sample_manifest import MANIFEST, write_sample_manifest
from gaussray.io.safe.limits import Limits, limit
from gaussray.render.focus import FocusMeter
from gaussray.render.job import RenderJob
from gaussray.render.randomize.clearance import FreeSpace
from gaussray.render.randomize.distributions import read_distributions
from gaussray.render.randomize.generate import (
    Distributions,
    MakeJob,
    generate_samples,
    refuse_other_samples,
)
from gaussray.render.randomize.options import DrawOptions
from gaussray.render.rig.view_files import load_views
from gaussray.runtime.devices import DevicesOptions, is_distributed, start_devices
from gaussray.runtime.progress import say
from gaussray.scene.formats.any_file import load
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.tracer.options import TraceOptions


# Keys about progress and reports.
_REPORTING = ("quiet", "progress", "report")
# Keys that say where and by whom a sample is rendered: they are no parameters of the sample.
_NO_PARAMETERS = (
    *("preset", "out", "devices", "limits", "sample", "dataset", "imu"),
    *_REPORTING,
)
# Keys that may differ between the processes that work on one dataset.
_PER_PROCESS = (
    "out",
    "devices",
    "dataset.shard",
    "dataset.shards",
    "render.memory",
    *_REPORTING,
)
# Scenes and captures that are kept for the next samples.
_KEPT = 2
# The distribution of every seed of a randomised dataset. The seed of shake has single precision, to
# which the number of the camera is added.
_SEEDS = {"integer": [0, 2**31 - 1]}
_SHAKE_SEEDS = {"integer": [0, 2**23]}


def generate_dataset(cfg: Configuration, overrides: Sequence[str]) -> str:
    """Render samples of the distributions in `sample`.

    It is this process's shard, or all shards through Hydra's launcher.

    Args:
        cfg: the configuration.
        overrides: its words.

    Returns:
        A line about the result, for the user.
    """
    dataset, out = build_options(DrawOptions, cfg.dataset), Path(cfg.out)
    layout, imu = dataset.layout, build_options(ImuOptions, cfg.imu)
    if layout:
        cfg, overrides = _with_labels(cfg, overrides, layout)
    if dataset.shards > 1:
        # All shards share one folder, also if it is named by the time.
        overrides = [*(word for word in overrides if not word.startswith("out=")), f"out={out}"]
        jobs = [
            [f"dataset.shard={i}/{dataset.shards}", "dataset.shards=1"]
            for i in range(dataset.shards)
        ]
        launch_jobs("render", overrides, jobs, functools.partial(render_shard, overrides))
        with contextlib.suppress(OSError):
            (out / "jobs").rmdir()  # which stays empty unless a cluster has left files
        missing = write_sample_manifest(out, dataset.count)
    else:
        missing = render_shard(overrides, cfg)
    if missing:
        return f"{out}: {missing} of {dataset.count} samples are left to other shards."
    if layout:
        frames = write_layout(out, out / layout, layout, imu=imu)
        return f"{out / layout}: {dataset.count} samples, {frames} frames in the layout {layout}."
    return f"{out / MANIFEST}: {dataset.count} samples."


def _with_labels(
    cfg: Configuration, overrides: Sequence[str], layout: str
) -> tuple[Configuration, Sequence[str]]:
    """The configuration and its words with the labels that a layout needs."""
    if layout not in LAYOUT_LABELS:
        known = ", ".join(LAYOUT_LABELS)
        raise ValueError(f"dataset.layout must be empty or one of {known}, got {layout!r}.")
    if cfg.format != "png":
        raise ValueError(f"format must be png with dataset.layout={layout}, got {cfg.format!r}.")
    labels = list(dict.fromkeys([*to_plain(cfg.labels), *LAYOUT_LABELS[layout]]))
    overrides = [*overrides, f"labels=[{','.join(labels)}]"]
    return compose_config("render", overrides), overrides


def render_shard(overrides: Sequence[str], cfg: Configuration) -> int:
    """Render the samples of one shard.

    Args:
        overrides: words of the configuration.
        cfg: the configuration.

    Returns:
        The number of samples, of all shards, that are still missing.

    Raises:
        ValueError: several hosts are to share a frame.
    """
    limit(build_options(Limits, cfg.limits))
    devices = start_devices(build_options(DevicesOptions, cfg.devices))
    if is_distributed():
        raise ValueError(
            "devices.hosts must be 1 with dataset.count: processes share the samples by "
            "dataset.shard."
        )
    source = sample_source(cfg, overrides)
    made = source.distributions, source.make_job, source.options
    refuse_other_samples(Path(cfg.out), *made)
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
    options: DrawOptions


def sample_source(cfg: Configuration, overrides: Sequence[str]) -> SampleSource:
    """The distributions and jobs of a configuration of `gaussray render`.

    The scene and the cameras are read once for all samples.

    Args:
        cfg: the composed configuration, with the distributions in its `sample`.
        overrides: words that it was composed from; each sample adds its drawn values to them.

    Raises:
        ValueError: a distribution is malformed, or is of no key of the configuration.
    """
    _check_drawn_keys(cfg, overrides)
    variations = Variations("render", overrides)
    read, cameras = functools.lru_cache(_KEPT)(load), functools.lru_cache(_KEPT)(load_views)
    options = build_options(DrawOptions, cfg.dataset)
    meters: dict[tuple[int, TraceOptions], FocusMeter] = {}
    # Samples of as many frames share a line.
    note = functools.cache(say)

    def meter(scene: Scene | Clip, trace: TraceOptions) -> FocusMeter:
        # A meter holds its scene, whose id is therefore no other one's.
        key = id(scene), trace
        if key not in meters:
            if len(meters) == _KEPT:
                meters.pop(next(iter(meters)))
            meters[key] = FocusMeter(scene, trace)
        return meters[key]

    @functools.lru_cache(_KEPT)
    def free_space(scene: str, capture: str | None, trace: TraceOptions) -> FreeSpace:
        views = cameras(scene, capture) if has_cameras(cfg) else ()
        return FreeSpace(read(scene), [view.camera for view in views], trace)

    def make_job(values: Mapping[str, Any]) -> tuple[dict[str, Any], RenderJob]:
        varied = variations.with_values(values)
        parameters = {k: v for k, v in to_plain(varied).items() if k not in _NO_PARAMETERS}
        # Pictures do not depend on it: a dataset that ran out of memory continues with less.
        del parameters["render"]["memory"]
        job = render_job(varied, read, cameras, meter=meter)
        check_layout(options.layout, job.records, note)
        parameters["aperture"] |= chosen_lengths(parameters["aperture"], job.records[0].camera)
        if options.clearance:
            space = free_space(varied.scene, varied.cameras, job.trace)
            for record in job.records:
                space.check(record.camera, options.clearance)
        return parameters, job

    return SampleSource(
        all_distributions(cfg, functools.partial(cameras, cfg.scene, cfg.cameras)),
        make_job,
        options,
    )


def _check_drawn_keys(cfg: Configuration, overrides: Sequence[str]) -> None:
    """Refuse distributions of what is no key, and choices that a group does not have: another draw
    of them is as impossible."""
    here = groups("render")
    known = {*here, *keys("render")}
    known |= {
        f"{group}.{k}" for group in here for c in choices(group) for k in choice_keys(group, c)
    }
    # The files of a search path may define other choices, and keys.
    only_ours = not any(word.startswith("hydra.searchpath") for word in overrides)
    for key, spec in read_distributions(to_plain(cfg.get("sample") or {})).items():
        group, _, name = key.rpartition(".")
        node = OmegaConf.select(cfg, group) if group else cfg
        if key not in known and not (OmegaConf.is_dict(node) and name in node):
            raise ValueError(
                f"sample.{key}: {key} is no key of `gaussray render`.{did_you_mean(key, known)} "
                "Its `--help=all` lists them."
            )
        drawn = map(str, spec.get("choice", ())) if key in here and only_ours else ()
        other = next((choice for choice in drawn if choice not in choices(key)), None)
        if other is not None:
            raise ValueError(
                f"sample.{key}.choice must be among {', '.join(choices(key))}, got {other!r}."
                f"{did_you_mean(other, choices(key))}"
            )


def all_distributions(
    cfg: Configuration, views: Callable[[], Sequence[View]] = tuple
) -> dict[str, dict[str, Any]]:
    """The distributions from which samples are drawn, by key.

    They are those in `sample`, one for every seed of the configuration (two samples must not have
    the same noise), and those of the camera and the times of `dataset.frames` successive frames.

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
    count, camera = cfg.dataset.frames, to_plain(cfg.camera)
    keys = ("trajectory", "trajectory.kind", "camera", "camera.kind")
    moved = cfg.trajectory.kind != "keep" or camera.get("kind", "capture") != "capture"
    if not count or moved or any(key in drawn for key in keys):
        return {}
    splits = drawn.get("camera.split", {}).get("choice", [camera["split"]])
    times: dict[str, set[float]] = {}
    for view in views():
        name = view.camera_name
        of_split = "all" in splits or view.split in splits
        if name in camera["names"] if camera["names"] else of_split:
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
