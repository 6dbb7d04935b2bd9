"""The files of a dataset beside its pictures: manifests, videos, and the record of its inputs."""

import dataclasses
import json
import time as clock
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from gaussray.camera.sensor.sensor import sensor_record
from gaussray.capture.formats.transforms import effect_file
from gaussray.capture.picture_file import read_stored
from gaussray.dataset.manifest import (
    FrameRecord,
    ManifestEntry,
    manifest_entry,
    write_manifest,
)
from gaussray.dataset.video import write_video
from gaussray.io.atomic import atomic_path, check_files_exist
from gaussray.io.safe.files import read_json
from gaussray.render.aov.files import label_units
from gaussray.render.aov.labeller import PICTURE_LABELS
from gaussray.render.develop import sensor_of
from gaussray.render.frame import SHARE
from gaussray.render.options import NO_SENSOR, DatasetOptions
from gaussray.runtime.devices import cores, is_distributed, is_primary
from gaussray.runtime.provenance import array_digest
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip


# Seconds within which a shared folder shows the files that another host has written.
_NETWORK_DELAY = 90.0
# Bytes of frames that may wait to be encoded in videos.
MOST_KEPT = 1024**3
# The file that records the inputs of a dataset.
INPUTS_FILE = "render.sha256"


def claim_folder(
    out: Path, scene: Scene | Clip, records: Sequence[FrameRecord], settings: tuple[Any, ...]
) -> None:
    """Record the inputs of a dataset in its folder, as the SHA-256 of scene, cameras and settings.

    Args:
        out: the folder.
        scene: the scene.
        records: the frames.
        settings: further settings that the pictures depend on.

    Raises:
        ValueError: The folder records other inputs, so its pictures are of something else.
        OSError: The folder cannot be written.
    """
    digest = array_digest((scene, [record.camera for record in records]))
    files = [record.file_path for record in records]
    static = [jax.tree.structure(record.camera) for record in records]
    digest.update(repr((files, static, *settings)).encode())
    note, text = out / INPUTS_FILE, digest.hexdigest() + "\n"
    try:
        if note.exists() and note.read_text() != text:
            raise ValueError(
                f"out={out} holds pictures of another scene, camera or option. Choose another "
                "folder, or delete this one."
            )
        if is_primary():
            with atomic_path(note) as partial:
                partial.write_text(text)
    except OSError as error:
        raise OSError(f"out={out}: cannot be written: {error.strerror or error}") from error


def require_files(out: Path, records: Sequence[FrameRecord]) -> None:
    """Check that all pictures and labels exist.

    Files of other hosts may appear late in a shared folder, and are waited for.

    Args:
        out: folder of the dataset.
        records: the frames.

    Raises:
        OSError: A file is missing.
    """
    files = [path for r in records for path in (r.file_path, *(r.labels or {}).values())]
    if not is_distributed():
        check_files_exist(out, files)
    deadline = clock.monotonic() + _NETWORK_DELAY
    while missing := [path for path in files if not (out / path).exists()]:
        if clock.monotonic() > deadline:
            raise OSError(
                f"out={out}: {len(missing)} files that other hosts have written are not here, "
                f"such as {missing[0]}. Choose a folder that all hosts share."
            )
        clock.sleep(0.5)


def picture_entry(out: Path, record: FrameRecord) -> ManifestEntry:
    """The entry in a manifest of a picture that is written.

    Args:
        out: folder of the dataset.
        record: the frame.
    """
    return manifest_entry(_with_samples(out, record))


def write_manifests(
    out: Path,
    records: Sequence[FrameRecord],
    options: DatasetOptions,
    entries: Mapping[str, ManifestEntry],
) -> None:
    """Write one manifest per effect, with sensor, labels and `info`.

    Args:
        out: folder of the dataset.
        records: the frames.
        options: sensor, labels and info.
        entries: entries of pictures that have been made already, by file.
    """
    entries = {r.file_path: entries.get(r.file_path) or picture_entry(out, r) for r in records}
    for effect in dict.fromkeys(record.effect for record in records):
        frames = [r for r in records if r.effect == effect]
        used = sensor_of(frames[0], options.sensor)
        facts, extra = dict[str, Any](options.info), dict[str, Any]()
        if used != NO_SENSOR:
            facts["sensor"] = sensor_record(used)
        if options.labels and effect not in PICTURE_LABELS:
            facts["labels"] = label_units(options.labels)
        if used.tone == "linear":
            extra["color_space"] = "linear"
        if facts:
            extra["info"] = facts
        write_manifest(out / effect_file(effect), frames, extra=extra, entries=entries)


def write_sample_count(picture: Path, samples: int, error: Float[np.ndarray, "h w"]) -> None:
    """Write the rays per pixel that `render.error` needed, beside a picture.

    Args:
        picture: the picture.
        samples: rays per pixel.
        error: standard error of each pixel.
    """
    values = {"samples": samples, "error": float(np.quantile(error, SHARE))}
    with atomic_path(picture.with_suffix(".json")) as partial:
        partial.write_text(json.dumps(values) + "\n")


def _with_samples(out: Path, record: FrameRecord) -> FrameRecord:
    """The record with the rays per pixel that are written beside its picture, if any."""
    note = (out / record.file_path).with_suffix(".json")
    if not note.exists():
        return record
    values = read_json(note)
    if not isinstance(values, dict) or type(values.get("samples")) is not int:
        raise ValueError(f"{note}: must hold the samples of its picture. Delete both.")
    return dataclasses.replace(record, samples=values["samples"])


def video_name(record: FrameRecord) -> str:
    """The name of the video that a frame belongs to: one per effect and camera."""
    return f"{record.effect}_{record.camera_name}"


class Videos:
    """Encodes a video for every effect and camera, in a thread for each, while frames are rendered.

    Frames are taken from memory as they are rendered. Those that were there before, or for which
    memory has no room, are read from the pictures in the folder.

    Args:
        out: folder of the dataset.
        records: all frames.
        fps: frames per second.
        rendered: the frames that `add` will bring, in the order of `records`.
    """

    def __init__(
        self,
        out: Path,
        records: Sequence[FrameRecord],
        fps: float,
        rendered: Sequence[FrameRecord],
    ):
        self._out, self._fps = out, fps
        self._rendered = {record.file_path for record in rendered}
        self._frames: dict[str, list[FrameRecord]] = {}
        for record in records:
            self._frames.setdefault(video_name(record), []).append(record)
        self._arrived = {name: SimpleQueue[np.ndarray | None]() for name in self._frames}
        self._kept, self._counting = 0, Lock()
        self._encoding: dict[str, Future[None]] = {}
        self._pool = ThreadPoolExecutor(cores(), thread_name_prefix="video")
        self._stopped = False

    def __enter__(self) -> "Videos":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """After an error, unfinished videos are given up."""
        self._stopped = kind is not None
        for arrived in self._arrived.values():
            arrived.put(None)
        self._pool.shutdown(cancel_futures=self._stopped)

    def add(self, record: FrameRecord, stored: np.ndarray) -> None:
        """Take the next frame, whose picture is written.

        Args:
            record: the frame.
            stored: the values of its picture.
        """
        name = video_name(record)
        if record.file_path in self._rendered and len(self._frames[name]) > 1:
            kept = self._keep(stored.nbytes)
            self._arrived[name].put(stored if kept else None)
            self._begin(name)

    def finish(self) -> None:
        """Encode the remaining videos, and wait for all."""
        for name, records in self._frames.items():
            if len(records) > 1:
                self._begin(name)
        for video in self._encoding.values():
            video.result()

    def _begin(self, name: str) -> None:
        if name not in self._encoding:
            path = self._out / f"{name}.mp4"
            self._encoding[name] = self._pool.submit(
                write_video, path, self._pictures(name), self._fps
            )

    def _pictures(self, name: str) -> Iterator[np.ndarray]:
        """The frames of a video, each as soon as it is there."""
        for record in self._frames[name]:
            film, stored = record.camera.film, None
            if record.file_path in self._rendered:
                stored = self._arrived[name].get()
            if self._stopped:
                raise InterruptedError("the frames of the video will not be rendered")
            if stored is None:
                stored = read_stored(self._out / record.file_path, film.width, film.height)
            else:
                self._keep(-stored.nbytes)
            yield stored

    def _keep(self, size: int) -> bool:
        """Whether memory has room for so many bytes of frames, which then count as kept."""
        with self._counting:
            if self._kept + size > MOST_KEPT:
                return False
            self._kept += size
            return True
