"""A data set of pictures: what cameras see of a scene, as a paired capture in a folder."""

import dataclasses
import hashlib
import json
import os
import time as clock
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.camera import with_chromatic
from gaussray.camera.sensor.noise import picture_key
from gaussray.camera.sensor.sensor import (
    SensorOptions,
    amounts,
    check_sensor,
    develop_by,
    encode,
    sensor_record,
    steps_of,
)
from gaussray.capture.picture_file import read_stored
from gaussray.dataset.images import codes, write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.dataset.video import write_video
from gaussray.io.atomic import demand, sweep, whole
from gaussray.io.safe.files import read_json
from gaussray.render.aov.files import SHARP, annotated, complete, described as units, write_labels
from gaussray.render.aov.labeller import Labeller
from gaussray.render.frame import SHARE, Frame
from gaussray.render.renderer import Renderer, RenderOptions
from gaussray.runtime.devices import agreed, leads, share, together, wait
from gaussray.runtime.lock import locks_output
from gaussray.runtime.progress import Progress
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.tracer.trace import TraceOptions


# Seconds within which a shared folder shows what another host has written.
PATIENCE = 90.0
# Bytes of pictures that wait to be written.
BACKLOG = 2 * 1024**3
# Light is written as it is.
NO_SENSOR = SensorOptions()
# A half float holds the numbers of so many bits apart.
HALF_BITS = 10


@locks_output
def render_dataset(
    scene: Scene | Clip,
    records: Sequence[FrameRecord],
    out: Path | str,
    *,
    options: RenderOptions,
    trace: TraceOptions,
    sensor: SensorOptions = NO_SENSOR,
    info: Mapping[str, Any] | None = None,
    labels: Sequence[str] = (),
    fps: float = 8.0,
    devices: int | None = None,
    renderer: Renderer | None = None,
    quiet: bool = False,
) -> Path:
    """Write every recorded frame as a picture, each effect's manifest, and a video per camera.

    A `sensor` develops the light before it is written; manifests record it, beside `info`. `labels`
    (`gaussray.render.aov.labeller`) are written beside the pictures; sharp twins know no sensor.
    The folder is a paired capture: it can be read back, reconstructed and evaluated. A picture that
    is already there is kept, so an interrupted run goes on; a folder that was begun with another
    scene, camera or option is refused. Each host renders its share of what is missing, on so many
    `devices` (None is all); the first one writes the rest when all pictures are there. A `renderer`
    of this scene, with these options, saves measuring and compiling once more.
    """
    if labels and isinstance(scene, Clip):
        raise ValueError(
            f"labels need a scene of one segment, got {len(scene.segments)} segments: reconstruct "
            "with fit.segment=0, or leave labels empty."
        )
    out, records = Path(out), annotated(records, labels)
    for record in {id(r.camera.lens): r for r in records}.values():
        check_sensor(sensor, record.camera, Path(record.file_path).suffix[1:])
    # However a frame is cut, it is the same: who ran out of memory goes on with less of it.
    made_with = dataclasses.replace(options, memory=RenderOptions().memory), trace
    made_with = made_with if sensor == NO_SENSOR else (*made_with, sensor)
    _claim(out, scene, records, (*made_with, tuple(labels)) if labels else made_with)
    if leads():
        sweep(out, deep=True)
    # No host looks for what is there before the first has swept.
    wait("swept")
    there = agreed(np.array([(out / record.file_path).exists() for record in records]))
    own = share([record for record, old in zip(records, there, strict=True) if not old])
    render = renderer or Renderer(scene, options=options, trace=trace, devices=devices)
    progress = Progress("render", len(own), quiet=quiet or not leads())
    frames = render.film(
        with_chromatic(record.camera, _sensor_of(record, sensor).chromatic) for record in own
    )
    missing = Counter(_video(record) for record, old in zip(records, there, strict=True) if not old)
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        videos = _Videos(out, records, fps, pool)
        for done, record in enumerate(_written(out, own, frames, sensor, pool), 1):
            progress.report(done, record.effect)
            missing[_video(record)] -= 1
            # What other hosts have a part in waits for them.
            if leads() and not missing[_video(record)]:
                videos.begin(_video(record))
        if labels and isinstance(scene, Scene):
            _label(out, scene, records, labels, options, trace, quiet=quiet)
        wait("pictures")
        if leads():
            _demand_all(out, records)
            _write_lists(out, records, sensor, labels, info or {})
            videos.finish()
    wait("videos")
    return out


def _written(
    out: Path,
    records: Sequence[FrameRecord],
    frames: Iterator[Frame],
    sensor: SensorOptions,
    pool: ThreadPoolExecutor,
) -> Iterator[FrameRecord]:
    """The records whose pictures are written, in order: each core compresses one while the devices
    go on. What waits for a core is bounded in number and in bytes."""
    cores, waiting = os.cpu_count() or 1, deque()
    for record, frame in zip(records, frames, strict=True):
        if frame.error is not None:
            _note_samples(out / record.file_path, frame.samples, frame.error)
        writing = pool.submit(_write, out, record, frame.color, _sensor_of(record, sensor))
        waiting.append((record, writing))
        while len(waiting) > min(2 * cores, BACKLOG // frame.color.nbytes):
            record, writing = waiting.popleft()
            writing.result()
            yield record
    for record, writing in waiting:
        writing.result()
        yield record


def _write(out: Path, record: FrameRecord, light: np.ndarray, sensor: SensorOptions) -> None:
    """A picture's file: the light itself, or what a sensor makes of it."""
    path = out / record.file_path
    if path.suffix != ".exr" or sensor == NO_SENSOR:
        write_image(path, light if path.suffix == ".exr" else stored(record, light, sensor))
    else:
        depth = "float" if sensor.bits > HALF_BITS else "half"
        write_image(path, _sensed(record, light, sensor), depth=depth)


def stored(record: FrameRecord, light: np.ndarray, sensor: SensorOptions) -> np.ndarray:
    """The 8-bit codes that a PNG holds of a frame's light."""
    if sensor == NO_SENSOR:
        return codes(light)
    light = _sensed(record, light, sensor)
    if sensor.tone == "srgb":
        return codes(light)
    return codes(light, lambda x: encode(jnp.asarray(x), options=sensor))


def _sensed(record: FrameRecord, light: np.ndarray, sensor: SensorOptions) -> np.ndarray:
    """The sensor's linear values of a frame; its noise is of the file's name."""
    key = picture_key(sensor.seed, str(Path(record.file_path).with_suffix("")))
    given = amounts(sensor), jnp.asarray(light), record.camera, key
    return np.asarray(_developed(*given, steps=steps_of(sensor)))


_developed = eqx.filter_jit(develop_by)


def _sensor_of(record: FrameRecord, sensor: SensorOptions) -> SensorOptions:
    """What develops a picture: a sharp twin is light as it is."""
    return NO_SENSOR if record.effect == SHARP else sensor


def _label(
    out: Path,
    scene: Scene,
    records: Sequence[FrameRecord],
    labels: Sequence[str],
    options: RenderOptions,
    trace: TraceOptions,
    *,
    quiet: bool,
) -> None:
    """Write this host's share of the labels that are not there."""
    there = agreed(np.array([complete(out, record) for record in records]))
    own = {
        r.file_path for r in share([r for r, old in zip(records, there, strict=True) if not old])
    }
    progress = Progress("labels", len(own), quiet=quiet or not leads())
    labeller = Labeller(scene, options=options, trace=trace)
    for done, record in enumerate(write_labels(out, records, own, labels, labeller), 1):
        progress.report(done, record.effect)


def _demand_all(out: Path, records: Sequence[FrameRecord]) -> None:
    """Every file, also those that other hosts have written, which a network may show late."""
    files = [path for r in records for path in (r.file_path, *(r.labels or {}).values())]
    if not together():
        demand(out, files)
    patience = clock.monotonic() + PATIENCE
    while missing := [path for path in files if not (out / path).exists()]:
        if clock.monotonic() > patience:
            raise OSError(
                f"out={out}: {len(missing)} files that other hosts have written are not here, "
                f"such as {missing[0]}. Choose a folder that all hosts share."
            )
        clock.sleep(0.5)


def _write_lists(
    out: Path,
    records: Sequence[FrameRecord],
    sensor: SensorOptions,
    labels: Sequence[str],
    info: Mapping[str, Any],
) -> None:
    records = [_as_sampled(out, record) for record in records]
    for effect in dict.fromkeys(record.effect for record in records):
        name = "transforms" if effect == "pinhole" else effect
        listed = [r for r in records if r.effect == effect]
        used, said, extra = _sensor_of(listed[0], sensor), {**info}, dict[str, Any]()
        if used != NO_SENSOR:
            said["sensor"] = sensor_record(used)
        if labels and effect != SHARP:
            said["labels"] = units(labels)
        if used.tone == "linear":
            extra["color_space"] = "linear"
        if said:
            extra["info"] = said
        write_manifest(out / f"{name}.json", listed, extra=extra)


def _note_samples(picture: Path, samples: int, error: np.ndarray) -> None:
    """Beside a picture, the rays per pixel that `render.error` took, and the error reached."""
    told = {"samples": samples, "error": float(np.quantile(error, SHARE))}
    with whole(picture.with_suffix(".json")) as partial:
        partial.write_text(json.dumps(told) + "\n")


def _as_sampled(out: Path, record: FrameRecord) -> FrameRecord:
    """The record with the rays per pixel that are noted beside its picture, if any."""
    note = (out / record.file_path).with_suffix(".json")
    if not note.exists():
        return record
    told = read_json(note)
    if not isinstance(told, dict) or type(told.get("samples")) is not int:
        raise ValueError(f"{note}: must hold the samples of its picture. Delete both.")
    return dataclasses.replace(record, samples=told["samples"])


def _video(record: FrameRecord) -> str:
    return f"{record.effect}_{record.camera_name}"


class _Videos:
    """A video of every effect and camera, from the pictures that are written."""

    def __init__(
        self, out: Path, records: Sequence[FrameRecord], fps: float, pool: ThreadPoolExecutor
    ):
        self._out, self._fps, self._pool = out, fps, pool
        self._shown: dict[str, list[FrameRecord]] = {}
        for record in records:
            self._shown.setdefault(_video(record), []).append(record)
        self._begun: dict[str, Future[None]] = {}

    def begin(self, name: str) -> None:
        """Make one whose pictures are all there, while others are rendered."""
        if name not in self._begun:
            self._begun[name] = self._pool.submit(self._film, name)

    def finish(self) -> None:
        """Make those that are not begun, and wait for all."""
        for name in self._shown:
            self.begin(name)
        for video in self._begun.values():
            video.result()

    def _film(self, name: str) -> None:
        own, film = self._shown[name], self._shown[name][0].camera.film
        if len(own) > 1:
            pictures = (read_stored(self._out / r.file_path, film.width, film.height) for r in own)
            write_video(self._out / f"{name}.mp4", pictures, self._fps)


def _claim(
    out: Path, scene: Scene | Clip, records: Sequence[FrameRecord], made_with: tuple
) -> None:
    """Note in `out` what its pictures are made of, unless another note is there already."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(jax.device_get((scene, [record.camera for record in records]))):
        digest.update(np.asarray(leaf).tobytes())
    files = [record.file_path for record in records]
    static = [jax.tree.structure(record.camera) for record in records]
    digest.update(repr((files, static, *made_with)).encode())
    note, own = out / "render.sha256", digest.hexdigest() + "\n"
    try:
        if note.exists() and note.read_text() != own:
            raise ValueError(
                f"out={out} holds pictures of another scene, camera or option. Choose another "
                "folder, or delete this one."
            )
        if leads():
            with whole(note) as partial:
                partial.write_text(own)
    except OSError as error:
        raise OSError(f"out={out}: cannot be written: {error.strerror or error}") from error
