"""From a configuration to pictures: the shot it describes, or all takes of a distribution."""

import contextlib
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from gaussray.camera.sensor.sensor import SensorOptions
from gaussray.config.compose import Configuration, Variations
from gaussray.config.launch import launch_jobs
from gaussray.config.options import as_type, build_options
from gaussray.config.run_folder import begin_run_folder
from gaussray.config.yaml_files import to_plain
from gaussray.dataset.takes import MANIFEST, write_takes
from gaussray.io.safe.limits import Limits, limit
from gaussray.render.aov.labeller import check_labels
from gaussray.render.randomize.distributions import distributions
from gaussray.render.randomize.generate import Shot, produce as produce_takes
from gaussray.render.randomize.options import FactoryOptions
from gaussray.render.renderer import RenderOptions
from gaussray.render.rig import physical_units as physical, rig as rigs
from gaussray.render.rig.validate import check_possible
from gaussray.runtime.devices import DevicesOptions, begin, together
from gaussray.scene.store import load_scene
from gaussray.tracer.trace import TraceOptions


# Keys that say what is told of the work, and those that say where and by whom takes are made, not
# what they are.
TALK = ("quiet", "progress", "report")
ELSEWHERE = ("preset", "out", "devices", "limits", "sample", "factory", *TALK)
# Keys in which processes differ that work on one data set.
SHARED = ("out", "devices", "factory.shard", "factory.shards", "render.memory", *TALK)
SEEDS = {"integer": [0, 2**31 - 1]}


def rig_options(cfg: Configuration) -> rigs.RigOptions:
    """The camera that a configuration asks for, but for its `physical` numbers."""
    return rigs.RigOptions(
        camera=build_options(rigs.CameraOptions, cfg.camera),
        lens=build_options(rigs.LensOptions, cfg.lens),
        aperture=build_options(rigs.ApertureOptions, cfg.aperture),
        shutter=build_options(rigs.ShutterOptions, cfg.shutter),
        trajectory=build_options(rigs.TrajectoryOptions, cfg.trajectory),
        film=build_options(rigs.FilmOptions, cfg.film),
    )


def shot_of(
    cfg: Configuration, load: Callable = load_scene, cameras: Callable = rigs.cameras_of
) -> Shot:
    """What is filmed; `load` and `cameras` read scenes and views where many shots share them."""
    wanted = rig_options(cfg)
    given = build_options(physical.PhysicalOptions, cfg.physical)
    sensor = build_options(SensorOptions, cfg.sensor)
    sampling, trace = (
        build_options(RenderOptions, cfg.render),
        build_options(TraceOptions, cfg.trace),
    )
    fps = as_type(float, cfg.fps, "fps")
    if not fps > 0:
        raise ValueError(f"fps must be above 0, got {fps}.")
    asked = as_type(tuple, to_plain(cfg.labels), "labels")
    check_labels(asked)
    scene = load(cfg.scene)
    views = cameras(cfg.scene, cfg.cameras)
    film = physical.applied(wanted, given)
    records = rigs.rig(
        views, options=film, samples=sampling.samples, format=as_type(str, cfg.format, "format")
    )
    physical.check_shape(given, (record.camera.film for record in records))
    check_possible(film, records)
    return Shot(
        scene, records, sampling, trace, sensor, physical.described(wanted, given), asked, fps
    )


def produce(cfg: Configuration, overrides: Sequence[str]) -> str:
    """Film takes of the distributions in `sample`, this process's share or all by Hydra's launcher;
    what is to be said of it."""
    chosen, out = build_options(FactoryOptions, cfg.factory), Path(cfg.out)
    if chosen.shards > 1:
        shares = range(chosen.shards)
        # All name one folder, also if it is named by the time.
        overrides = [*(word for word in overrides if not word.startswith("out=")), f"out={out}"]
        jobs = [[f"factory.shard={i}/{chosen.shards}", "factory.shards=1"] for i in shares]
        launch_jobs("render", overrides, jobs, functools.partial(film_share, overrides))
        with contextlib.suppress(OSError):
            (out / "jobs").rmdir()  # where no cluster has left anything
        missing = write_takes(out, chosen.count)
    else:
        missing = film_share(overrides, cfg)
    if missing:
        return f"{out}: {missing} of {chosen.count} takes are for other shards to film."
    return f"{out / MANIFEST}: {chosen.count} takes."


def film_share(overrides: Sequence[str], cfg: Configuration) -> int:
    """Film the takes of one shard; how many of all are not there yet."""
    limit(build_options(Limits, cfg.limits))
    devices = begin(build_options(DevicesOptions, cfg.devices))
    if together():
        raise ValueError(
            "devices.hosts must be 1 with factory.count: processes share takes by factory.shard."
        )
    variations = Variations("render", overrides)
    load, cameras = functools.lru_cache(2)(load_scene), functools.lru_cache(2)(rigs.cameras_of)

    def shoot(values: Mapping[str, Any]) -> tuple[dict[str, Any], Shot]:
        made = variations.with_values(values)
        parameters = {key: value for key, value in to_plain(made).items() if key not in ELSEWHERE}
        # No matter of the pictures: with less of it a data set is gone on with.
        del parameters["render"]["memory"]
        return parameters, shot_of(made, load, cameras)

    chosen = build_options(FactoryOptions, cfg.factory)
    out = begin_run_folder(cfg, without=SHARED, part=chosen.shard)
    how = {"options": chosen, "devices": devices}
    return produce_takes(out, _drawn(cfg), shoot, **how, quiet=cfg.quiet)


def _drawn(cfg: Configuration) -> dict[str, dict[str, Any]]:
    """The distributions of the configuration, and of all seeds in it: what happens by chance shall
    not happen twice."""
    seeds = {
        f"{group}.{key}": SEEDS
        for group, node in cfg.items()
        if OmegaConf.is_dict(node) and group not in ELSEWHERE
        for key in node
        if str(key).endswith("seed")
    }
    return seeds | distributions(to_plain(cfg.get("sample") or {}))
