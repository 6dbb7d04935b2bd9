"""The labels of a data set's pictures as files beside them, and their sharp twins."""

import dataclasses
import os
from collections import deque
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.ideal_pinhole import sharp
from gaussray.dataset.layers import write_codes, write_layers
from gaussray.dataset.manifest import FrameRecord
from gaussray.render.aov.labeller import CODES, LABELS, Labeller, check_labels


# Effect of the pictures that `sharp` asks for, and so the name of their manifest.
SHARP = "sharp"
# The label that stands for all layers of one file.
LAYERS = "layers"


def annotated(records: Sequence[FrameRecord], labels: Sequence[str]) -> list[FrameRecord]:
    """The records with the files of these labels, and the records of their sharp twins behind them.

    A picture `images/fisheye/cam00/0003.png` has its layers in `labels/fisheye/cam00/0003.exr`,
    its codes in `0003.moving.png` and the like beside them, and its twin in
    `images/sharp/fisheye/cam00/0003.png`.
    """
    check_labels(labels)
    if not labels:
        return list(records)
    own = [dataclasses.replace(one, labels=_files(one, labels)) for one in records]
    return [*own, *(_twin(one) for one in own if SHARP in labels)]


def neighbours(
    records: Sequence[FrameRecord],
) -> dict[str, tuple[Camera | None, Camera | None]]:
    """The cameras of the frames before and after each file's, of the same camera and effect, by
    their times."""
    films: dict[tuple[str, str], list[FrameRecord]] = {}
    for record in records:
        films.setdefault((record.effect, record.camera_name), []).append(record)
    found = {}
    for film in films.values():
        film = sorted(film, key=lambda record: float(record.camera.time))
        cameras = [None, *(record.camera for record in film), None]
        for i, record in enumerate(film):
            found[record.file_path] = cameras[i], cameras[i + 2]
    return found


def complete(out: Path, record: FrameRecord) -> bool:
    """Whether the labels of a record are all there."""
    return all((out / path).exists() for path in _own(record).values())


def write_labels(
    out: Path,
    records: Sequence[FrameRecord],
    own: Collection[str],
    labels: Sequence[str],
    labeller: Labeller,
) -> Iterator[FrameRecord]:
    """The records with a picture among `own` as their labels are written, one after another; cores
    compress some while the device goes on. The other records are neighbours."""
    near = neighbours([record for record in records if record.effect != SHARP])
    waiting: deque[tuple[FrameRecord, Future[None]]] = deque()
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as pool:
        for record in records:
            if record.file_path not in own:
                continue
            before, after = near[record.file_path]
            found = labeller(record.camera, labels, before=before, after=after)
            waiting.append((record, pool.submit(_write, out, record, found)))
            while len(waiting) > cores:
                yield _written(waiting)
        while waiting:
            yield _written(waiting)


def described(labels: Sequence[str]) -> dict[str, str]:
    """What a manifest says of its labels: meaning and unit of each."""
    return {name: text for name, text in LABELS.items() if name in labels}


def _written(waiting: deque[tuple[FrameRecord, Future[None]]]) -> FrameRecord:
    record, writing = waiting.popleft()
    writing.result()
    return record


def _write(out: Path, record: FrameRecord, found: dict[str, np.ndarray]) -> None:
    files = _own(record)
    for name in files.keys() - {LAYERS}:
        write_codes(out / files[name], found[name])
    if LAYERS in files:
        layers = {name: image for name, image in found.items() if name not in CODES}
        write_layers(out / files[LAYERS], layers)


def _own(record: FrameRecord) -> dict[str, str]:
    """Files of a record's labels other than pictures."""
    return {name: path for name, path in (record.labels or {}).items() if name != SHARP}


def _files(record: FrameRecord, labels: Sequence[str]) -> dict[str, str]:
    path = Path(record.file_path)
    stem = Path("labels", *path.parts[1:]).with_suffix("")
    files = {LAYERS: f"{stem.as_posix()}.exr"} if set(labels) - {*CODES, SHARP} else {}
    files |= {name: f"{stem.as_posix()}.{name}.png" for name in CODES if name in labels}
    if SHARP in labels:
        files[SHARP] = Path(path.parts[0], SHARP, *path.parts[1:]).as_posix()
    return files


def _twin(record: FrameRecord) -> FrameRecord:
    files = record.labels or {}
    return dataclasses.replace(
        record,
        file_path=files[SHARP],
        camera=sharp(record.camera),
        effect=SHARP,
        mask_path=None,
        depth_file_path=None,
        labels=None,
    )
