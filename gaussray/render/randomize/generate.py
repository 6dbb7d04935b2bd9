"""Take after take of a distribution of cameras: drawn, checked, filmed, listed."""

import dataclasses
import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from gaussray.camera.sensor.sensor import SensorOptions
from gaussray.dataset.manifest import FrameRecord
from gaussray.dataset.takes import VERSION, folder_of, is_there, write_take, write_takes
from gaussray.io.atomic import sweep
from gaussray.render.dataset import NO_SENSOR, render_dataset
from gaussray.render.randomize.distributions import drawn
from gaussray.render.randomize.options import FactoryOptions
from gaussray.render.renderer import Renderer, RenderOptions
from gaussray.runtime.lock import output_lock
from gaussray.runtime.progress import Progress
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.tracer.trace import TraceOptions


# Scenes and settings that keep their renderers.
_RENDERERS = 8


class Shot(NamedTuple):
    """All that is filmed at once: what `filming.render_dataset` takes."""

    scene: Scene | Clip
    records: Sequence[FrameRecord]
    options: RenderOptions
    trace: TraceOptions
    sensor: SensorOptions
    info: Mapping[str, Any]
    labels: Sequence[str]
    fps: float


def film(
    shot: Shot,
    out: Path,
    *,
    renderer: Renderer | None = None,
    devices: int | None = None,
    quiet: bool = False,
) -> Path:
    """Write all of a shot into `out`."""
    how = {name: value for name, value in shot._asdict().items() if name not in _PLACED}
    how |= {"renderer": renderer, "devices": devices, "quiet": quiet}
    return render_dataset(shot.scene, shot.records, out, **how)


# What of a shot `render_dataset` takes by its place.
_PLACED = ("scene", "records")


class Take(NamedTuple):
    """What an index has become, at the attempt (from 0) that was possible: the `values` drawn, all
    `parameters` of the configuration, and the shot."""

    index: int
    attempt: int
    values: dict[str, Any]
    parameters: dict[str, Any]
    shot: Shot


Shoot = Callable[[Mapping[str, Any]], tuple[dict[str, Any], Shot]]


def take(
    index: int, of: Mapping[str, Mapping[str, Any]], shoot: Shoot, *, options: FactoryOptions
) -> Take:
    """The take of an index, from distributions and from what makes a shot of values (and raises a
    ValueError with key and rule where they are impossible)."""
    for attempt in range(options.redraws + 1):
        values = drawn(options.seed, index, attempt, of)
        try:
            return Take(index, attempt, values, *shoot(values))
        except ValueError as error:
            if attempt < options.redraws:
                continue
            tried = f" in {options.redraws + 1} attempts" if options.redraws else ""
            raise ValueError(
                f"take {index} is impossible{tried}: {error} Change its distribution in sample, or "
                "let factory.redraws draw such takes anew."
            ) from error
    raise AssertionError("there is at least one attempt")


def produce(
    out: Path,
    of: Mapping[str, Mapping[str, Any]],
    shoot: Shoot,
    *,
    options: FactoryOptions,
    devices: int | None = None,
    quiet: bool = False,
) -> int:
    """Film this shard's takes into `out`; the number of takes of all shards that are not there yet.

    No picture is taken before every camera of the shard is known to be possible. A take that is
    there is kept, one that was begun goes on with the pictures that are missing, and one that is
    there but would now be another is refused. With the last take comes the manifest of all.
    """
    own = options.indices
    for index in own:
        take(index, of, shoot, options=options)
    progress, stages = Progress("takes", len(own), quiet=quiet, anew=True), _Stages(devices)
    for done, index in enumerate(own, 1):
        one = take(index, of, shoot, options=options)
        frames = len(one.shot.records)
        with output_lock(out / folder_of(index)):
            _film(out, one, options.seed, stages)
        progress.report(done, f"{frames} frames of {one.shot.records[0].effect}")
    return write_takes(out, options.count)


class _Stages:
    """What takes share: fingerprints of their scenes, and renderers, whose lists are measured and
    whose programs are compiled."""

    def __init__(self, devices: int | None):
        self._devices = devices
        # With the scene, so that its identity is nobody else's.
        self._prints: dict[int, tuple[Scene | Clip, str]] = {}
        self._renderers: dict[tuple, tuple[Scene | Clip, Renderer]] = {}

    def fingerprint(self, scene: Scene | Clip) -> str:
        """SHA-256 of all that is in a scene."""
        if id(scene) not in self._prints:
            digest = hashlib.sha256()
            for leaf in jax.tree.leaves(jax.device_get(scene)):
                digest.update(np.asarray(leaf).tobytes())
            self._prints[id(scene)] = scene, digest.hexdigest()
        return self._prints[id(scene)][1]

    def renderer(self, shot: Shot) -> Renderer:
        """The one for a shot's scene and settings."""
        key = id(shot.scene), shot.options, shot.trace
        if key not in self._renderers:
            if len(self._renderers) == _RENDERERS:
                self._renderers.pop(next(iter(self._renderers)))
            how = {"options": shot.options, "trace": shot.trace, "devices": self._devices}
            self._renderers[key] = shot.scene, Renderer(shot.scene, **how)
        return self._renderers[key][1]


def _film(out: Path, one: Take, seed: int, stages: _Stages) -> None:
    """A take's pictures, and then its line, with which it is there."""
    folder, shot = out / folder_of(one.index), one.shot
    told = {
        "version": VERSION,
        "index": one.index,
        "folder": folder_of(one.index),
        "seed": seed,
        "attempt": one.attempt,
        "drawn": one.values,
        "parameters": one.parameters,
        "scene_sha256": stages.fingerprint(shot.scene),
    }
    if not is_there(folder, told):
        sweep(folder, deep=True)
        shot = shot._replace(sensor=_sensor(shot.sensor))
        film(shot, folder, renderer=stages.renderer(shot), quiet=True)
        write_take(folder, told, shot.records)


def _sensor(sensor: SensorOptions) -> SensorOptions:
    """A sensor that does nothing is none, whatever seed was drawn for its noise."""
    return NO_SENSOR if dataclasses.replace(sensor, seed=NO_SENSOR.seed) == NO_SENSOR else sensor
