"""Label files of a dataset, and ground-truth pictures of other cameras (`PICTURE_LABELS`)."""

import dataclasses
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import jax
import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.ideal_pinhole import ideal_pinhole_of
from gaussray.camera.shutter import row_moments, shutter_of_row
from gaussray.dataset.layers import write_integers, write_layers
from gaussray.dataset.manifest import FrameRecord
from gaussray.render.aov.labeller import (
    INTEGER_LABELS,
    LABELS,
    PICTURE_LABELS,
    Labeller,
    check_labels,
)
from gaussray.runtime.devices import cores


# The label of the pictures without effects, of which no sensor changes the light.
SHARP = "sharp"
# The key of the EXR file that holds all labels but whole numbers and `sharp`.
LAYERS = "layers"


def with_label_files(records: Sequence[FrameRecord], labels: Sequence[str]) -> list[FrameRecord]:
    """Add the label files of frames, and the frames of ground-truth pictures (`PICTURE_LABELS`).

    A picture `images/fisheye/cam00/0003.png` has float labels in `labels/fisheye/cam00/0003.exr`,
    whole numbers beside them in `0003.moving.png` and the like, and its ground truth in
    `images/sharp/fisheye/cam00/0003.png`.

    Args:
        records: the frames.
        labels: names of labels.

    Returns:
        The frames with the paths of their labels, then those of the ground-truth pictures.
    """
    check_labels(labels)
    if not labels:
        return list(records)
    with_files = [dataclasses.replace(one, labels=_files(one, labels)) for one in records]
    pictures = [label for label in PICTURE_LABELS if label in labels]
    return [*with_files, *(_truth_record(one, label) for label in pictures for one in with_files)]


def neighbour_cameras(
    records: Sequence[FrameRecord],
) -> dict[str, tuple[Camera | None, Camera | None]]:
    """The cameras of the previous and the next frame of each frame, of one camera name and effect.

    A single frame has those that its record names (`FrameRecord.neighbours`).

    Args:
        records: the frames.

    Returns:
        Previous and next camera by file.
    """
    sequences: dict[tuple[str, str], list[FrameRecord]] = {}
    for record in records:
        sequences.setdefault((record.effect, record.camera_name), []).append(record)
    neighbours = {}
    for frames in sequences.values():
        frames = sorted(frames, key=lambda record: float(record.camera.time))
        cameras = [None, *(record.camera for record in frames), None]
        if len(frames) == 1 and frames[0].neighbours is not None:
            before, after = frames[0].neighbours
            cameras = [before, frames[0].camera, after]
        for i, record in enumerate(frames):
            neighbours[record.file_path] = cameras[i], cameras[i + 2]
    return neighbours


def labels_exist(out: Path, record: FrameRecord) -> bool:
    """Whether all label files of a frame exist.

    Args:
        out: folder of the dataset.
        record: the frame.
    """
    return all((out / path).exists() for path in _label_files(record).values())


def write_labels(
    out: Path,
    records: Sequence[FrameRecord],
    assigned: Collection[str],
    labels: Sequence[str],
    labeller: Labeller,
) -> Iterator[FrameRecord]:
    """Write labels, and yield each frame when its files are written.

    The cores compress files while the device computes the next labels.

    Args:
        out: folder of the dataset.
        records: all frames; flow needs the neighbours of a frame.
        assigned: pictures whose labels are written.
        labels: names of the labels.
        labeller: computes them.
    """
    near = neighbour_cameras([r for r in records if r.effect not in PICTURE_LABELS])
    waiting: deque[tuple[FrameRecord, Future[None]]] = deque()
    with ThreadPoolExecutor(cores()) as pool:
        for record in records:
            if record.file_path not in assigned:
                continue
            before, after = near[record.file_path]
            values = labeller(record.camera, labels, before=before, after=after)
            waiting.append((record, pool.submit(_write, out, record, values)))
            while len(waiting) > cores():
                yield _next_written(waiting)
        while waiting:
            yield _next_written(waiting)


def label_units(labels: Sequence[str]) -> dict[str, str]:
    """Meaning and unit of each label, for a manifest."""
    return {name: text for name, text in LABELS.items() if name in labels}


def _next_written(waiting: deque[tuple[FrameRecord, Future[None]]]) -> FrameRecord:
    record, writing = waiting.popleft()
    writing.result()
    return record


def _write(out: Path, record: FrameRecord, values: dict[str, np.ndarray]) -> None:
    files = _label_files(record)
    for name in files.keys() - {LAYERS}:
        write_integers(out / files[name], values[name])
    if LAYERS in files:
        layers = {name: image for name, image in values.items() if name not in INTEGER_LABELS}
        write_layers(out / files[LAYERS], layers)


def _label_files(record: FrameRecord) -> dict[str, str]:
    """The label files of a record, without the ground truth pictures."""
    return {k: path for k, path in (record.labels or {}).items() if k not in PICTURE_LABELS}


def _files(record: FrameRecord, labels: Sequence[str]) -> dict[str, str]:
    path = Path(record.file_path)
    stem = Path("labels", *path.parts[1:]).with_suffix("")
    files = {LAYERS: f"{stem.as_posix()}.exr"} if _float_labels(labels) else {}
    files |= {name: f"{stem.as_posix()}.{name}.png" for name in INTEGER_LABELS if name in labels}
    for label in PICTURE_LABELS:
        if label in labels:
            files[label] = Path(path.parts[0], label, *path.parts[1:]).as_posix()
    return files


def _float_labels(labels: Sequence[str]) -> set[str]:
    """The labels that are channels of the EXR file."""
    return set(labels) - {*INTEGER_LABELS, *PICTURE_LABELS}


def _global_camera(camera: Camera, share: float) -> Camera:
    """The camera with a global shutter at the moment of the row at this share of the rows, in the
    order of their moments: fields and tables are not read in the order of the rows."""
    camera = jax.device_get(camera)
    size = camera.film.width, camera.film.height
    order = np.argsort(row_moments(camera.shutter, size), kind="stable")
    row = int(order[int(share * len(order))])
    return dataclasses.replace(camera, shutter=shutter_of_row(camera.shutter, size, row))


# The camera of each ground truth picture.
_TRUTHS: dict[str, Callable[[Camera], Camera]] = {
    SHARP: ideal_pinhole_of,
    "global_first": partial(_global_camera, share=0.0),
    "global_middle": partial(_global_camera, share=0.5),
}


def _truth_record(record: FrameRecord, label: str) -> FrameRecord:
    files = record.labels or {}
    return dataclasses.replace(
        record,
        file_path=files[label],
        camera=_TRUTHS[label](record.camera),
        effect=label,
        mask_path=None,
        depth_file_path=None,
        labels=None,
        neighbours=None,
    )
