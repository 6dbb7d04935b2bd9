"""Renders a dataset: pictures of a scene, as a paired capture in a folder."""

import dataclasses
import os
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.camera.camera import with_chromatic
from gaussray.camera.sensor.sensor import SensorOptions, check_sensor
from gaussray.dataset.manifest import FrameRecord
from gaussray.io.atomic import sweep
from gaussray.render.aov.files import labels_exist, with_label_files, write_labels
from gaussray.render.aov.labeller import Labeller
from gaussray.render.dataset_files import (
    Videos,
    claim_folder,
    require_files,
    video_name,
    write_manifests,
    write_sample_count,
)
from gaussray.render.develop import sensor_of, write_picture
from gaussray.render.frame import Frame
from gaussray.render.options import NO_SENSOR, DatasetOptions, RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.runtime.devices import agreed, leads, share, wait
from gaussray.runtime.lock import locks_output
from gaussray.runtime.progress import Progress
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip


# Bytes of pictures that may wait to be written.
BACKLOG = 2 * 1024**3


@locks_output
def render_dataset(
    renderer: Renderer,
    records: Sequence[FrameRecord],
    out: Path | str,
    *,
    options: DatasetOptions | None = None,
    quiet: bool = False,
    finished: Callable[[FrameRecord], object] = lambda record: None,
) -> Path:
    """Render a dataset into a folder: a picture per record, a manifest per effect, videos, labels.

    The folder is a paired capture, which can be read back, reconstructed and evaluated. Pictures
    that are already there are kept, so an interrupted run continues where it stopped. Each host
    renders its share of the missing pictures; host 0 writes manifests and videos when all pictures
    are there.

    Args:
        renderer: Renders the scene. Its options become part of the dataset's inputs.
        records: The frames: camera, and path of the picture (.png or .exr) from `out`.
        out: Folder for everything that is written.
        options: Sensor, labels, frame rate of the videos, and facts for the manifests.
        quiet: Whether to report no progress.
        finished: Called with the record of every picture that this call has written.

    Returns:
        The folder.

    Raises:
        ValueError: The folder holds pictures of another scene, camera or option; labels are asked
            of a scene in segments; or the sensor does not fit the pictures.
        OSError: A file cannot be written, or pictures of other hosts do not appear in the folder.
    """
    options = options or DatasetOptions()
    out, scene, records = Path(out), renderer.scene, with_label_files(records, options.labels)
    check_dataset(scene, records, options)
    claim_folder(out, scene, records, _settings(renderer, options))
    if leads():
        sweep(out, deep=True)
    # Hosts look for existing pictures only after host 0 has removed incomplete files.
    wait("swept")
    exists = agreed(np.array([(out / record.file_path).exists() for record in records]))
    missing = [record for record, there in zip(records, exists, strict=True) if not there]
    assigned = share(missing)
    frames = renderer.film(
        with_chromatic(record.camera, sensor_of(record, options.sensor).chromatic)
        for record in assigned
    )
    remaining = Counter(map(video_name, missing))
    progress = Progress("render", len(assigned), quiet=quiet or not leads())
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        videos = Videos(out, records, options.fps, pool)
        for done, record in enumerate(
            _write_pictures(out, assigned, frames, options.sensor, pool), 1
        ):
            progress.report(done, record.effect)
            finished(record)
            remaining[video_name(record)] -= 1
            # A video that other hosts render a part of waits for them.
            if leads() and not remaining[video_name(record)]:
                videos.begin(video_name(record))
        if options.labels:
            _write_labels(out, renderer, records, options, quiet=quiet)
        wait("pictures")
        if leads():
            require_files(out, records)
            write_manifests(out, records, options)
            videos.finish()
    wait("videos")
    return out


def check_dataset(
    scene: Scene | Clip, records: Sequence[FrameRecord], options: DatasetOptions
) -> None:
    """Check that labels and sensor are possible for frames.

    Args:
        scene: The scene.
        records: The frames.
        options: Labels and sensor.

    Raises:
        ValueError: They are not; the message names the key.
    """
    if options.labels and isinstance(scene, Clip):
        raise ValueError(
            f"labels need a scene of one segment, got {len(scene.segments)} segments: reconstruct "
            "with fit.segment=0, or leave labels empty."
        )
    for record in {id(r.camera.lens): r for r in records}.values():
        check_sensor(options.sensor, record.camera, Path(record.file_path).suffix[1:])


def _settings(renderer: Renderer, options: DatasetOptions) -> tuple[Any, ...]:
    """The settings that the pictures and labels depend on.

    `render.memory` is left out: it cuts a frame into strips but does not change it, and a run that
    ran out of memory continues with less.
    """
    unlimited = dataclasses.replace(renderer.options, memory=RenderOptions().memory)
    settings = unlimited, renderer.trace
    if options.sensor != NO_SENSOR:
        settings = *settings, options.sensor
    return (*settings, tuple(options.labels)) if options.labels else settings


def _write_pictures(
    out: Path,
    records: Sequence[FrameRecord],
    frames: Iterator[Frame],
    sensor: SensorOptions,
    pool: ThreadPoolExecutor,
) -> Iterator[FrameRecord]:
    """Yield the records as their pictures are written, in order. The cores compress pictures while
    the devices render the next ones; pictures that wait are bounded in number and in bytes."""
    cores, waiting = os.cpu_count() or 1, deque[tuple[FrameRecord, Future[None]]]()
    for record, frame in zip(records, frames, strict=True):
        path = out / record.file_path
        if frame.error is not None:
            write_sample_count(path, frame.samples, frame.error)
        writing = pool.submit(write_picture, path, record, frame.color, sensor_of(record, sensor))
        waiting.append((record, writing))
        while len(waiting) > min(2 * cores, BACKLOG // frame.color.nbytes):
            yield _next_written(waiting)
    while waiting:
        yield _next_written(waiting)


def _next_written(waiting: deque[tuple[FrameRecord, Future[None]]]) -> FrameRecord:
    """The record of the oldest picture, when it is written."""
    record, writing = waiting.popleft()
    writing.result()
    return record


def _write_labels(
    out: Path,
    renderer: Renderer,
    records: Sequence[FrameRecord],
    options: DatasetOptions,
    *,
    quiet: bool,
) -> None:
    """Write this host's share of the missing labels."""
    exists = agreed(np.array([labels_exist(out, record) for record in records]))
    missing = [record for record, there in zip(records, exists, strict=True) if not there]
    assigned = {record.file_path for record in share(missing)}
    progress = Progress("labels", len(assigned), quiet=quiet or not leads())
    labeller = Labeller(renderer.scenes[0], options=renderer.options, trace=renderer.trace)
    written = write_labels(out, records, assigned, options.labels, labeller, options.interval)
    for done, record in enumerate(written, 1):
        progress.report(done, record.effect)
