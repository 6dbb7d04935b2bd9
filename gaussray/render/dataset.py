"""Renders a dataset: pictures of a scene, as a paired capture in a folder."""

import dataclasses
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.camera.camera import with_chromatic
from gaussray.camera.sensor.sensor import check_sensor
from gaussray.dataset.manifest import FrameRecord, ManifestEntry
from gaussray.io.atomic import remove_partial_files
from gaussray.render.aov.files import labels_exist, with_label_files, write_labels
from gaussray.render.aov.labeller import Labeller
from gaussray.render.dataset_files import (
    Videos,
    claim_folder,
    picture_entry,
    require_files,
    write_manifests,
    write_sample_count,
)
from gaussray.render.develop import develop_picture, sensor_of, write_picture
from gaussray.render.frame import DevelopedFrame
from gaussray.render.options import NO_SENSOR, DatasetOptions, RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.runtime.devices import (
    barrier,
    cores,
    from_primary,
    is_distributed,
    is_primary,
    items_of_this_process,
)
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
    on_start: Callable[[], object] = lambda: None,
    on_picture: Callable[[FrameRecord], object] = lambda record: None,
) -> Path:
    """Render a dataset into a folder: a picture per record, a manifest per effect, videos, labels.

    The folder is a paired capture, which can be read back, reconstructed and evaluated. Pictures
    that are already there are kept, so an interrupted run continues where it stopped. Each host
    renders its share of the missing pictures; host 0 writes manifests and videos when all pictures
    are there.

    Args:
        renderer: renders the scene. Its options become part of the dataset's inputs.
        records: the frames: camera, and path of the picture (.png or .exr) from `out`.
        out: folder for everything that is written.
        options: sensor, labels, frame rate of the videos, and facts for the manifests.
        quiet: whether to report no progress.
        on_start: called once before the first file of the dataset is written, when it is known that
            the folder holds no other one.
        on_picture: called with the record of every picture that this call has written.

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
    on_start()
    if is_primary():
        remove_partial_files(out, deep=True)
    # Hosts look for existing pictures only after host 0 has removed incomplete files.
    barrier("swept")
    exists = from_primary(np.array([(out / record.file_path).exists() for record in records]))
    missing = [record for record, there in zip(records, exists, strict=True) if not there]
    assigned = items_of_this_process(missing)
    frames = renderer.render_developed(
        (
            with_chromatic(record.camera, sensor_of(record, options.sensor).chromatic)
            for record in assigned
        ),
        lambda i, values: develop_picture(
            assigned[i], values, sensor_of(assigned[i], options.sensor)
        ),
    )
    progress = Progress("render", len(assigned), quiet=quiet or not is_primary())
    # Where other hosts render a part, videos wait for all pictures.
    rendered = () if is_distributed() else assigned
    entries: dict[str, ManifestEntry] = {}
    with ThreadPoolExecutor(cores()) as pool, Videos(out, records, options.fps, rendered) as videos:
        for done, (record, stored) in enumerate(_write_pictures(out, assigned, frames, pool), 1):
            progress.report(done, record.effect)
            on_picture(record)
            videos.add(record, stored)
            # Now, while the devices render, and not one after another at the end.
            entries[record.file_path] = picture_entry(out, record)
        if options.labels:
            _write_labels(out, renderer, records, options, quiet=quiet)
        barrier("pictures")
        if is_primary():
            require_files(out, records)
            write_manifests(out, records, options, entries)
            videos.finish()
    barrier("videos")
    return out


def check_dataset(
    scene: Scene | Clip, records: Sequence[FrameRecord], options: DatasetOptions
) -> None:
    """Check that labels and sensor are possible for frames.

    Args:
        scene: the scene.
        records: the frames.
        options: labels and sensor.

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
    frames: Iterator[DevelopedFrame],
    pool: ThreadPoolExecutor,
) -> Iterator[tuple[FrameRecord, np.ndarray]]:
    """Yield the records and what their pictures store as these are written, in order. The cores
    compress pictures while the devices render the next ones; pictures that wait are bounded in
    number and in bytes."""
    waiting = deque[tuple[FrameRecord, np.ndarray, Future[None]]]()
    for record, frame in zip(records, frames, strict=True):
        path, stored = out / record.file_path, frame.values.values
        if frame.error is not None:
            write_sample_count(path, frame.samples, frame.error)
        waiting.append((record, stored, pool.submit(write_picture, path, frame.values)))
        while len(waiting) > min(2 * cores(), BACKLOG // stored.nbytes):
            yield _next_written(waiting)
    while waiting:
        yield _next_written(waiting)


def _next_written(
    waiting: deque[tuple[FrameRecord, np.ndarray, Future[None]]],
) -> tuple[FrameRecord, np.ndarray]:
    """The oldest picture, when it is written."""
    record, stored, writing = waiting.popleft()
    writing.result()
    return record, stored


def _write_labels(
    out: Path,
    renderer: Renderer,
    records: Sequence[FrameRecord],
    options: DatasetOptions,
    *,
    quiet: bool,
) -> None:
    """Write this host's share of the missing labels."""
    exists = from_primary(np.array([labels_exist(out, record) for record in records]))
    missing = [record for record, there in zip(records, exists, strict=True) if not there]
    assigned = {record.file_path for record in items_of_this_process(missing)}
    progress = Progress("labels", len(assigned), quiet=quiet or not is_primary())
    labeller = Labeller(renderer.scenes[0], options=renderer.options, trace=renderer.trace)
    written = write_labels(out, records, assigned, options.labels, labeller)
    for done, record in enumerate(written, 1):
        progress.report(done, record.effect)
