"""Frames that are rendered while they are read, as a PyTorch dataset."""

import functools
import itertools
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import torch
from jaxtyping import Array
from torch.utils.data import IterableDataset, get_worker_info

from gaussray.camera.camera import Camera, with_chromatic
from gaussray.config.compose import compose_config
from gaussray.config.samples import SampleSource, sample_source
from gaussray.dataset.manifest import FrameRecord, camera_to_world
from gaussray.dataset.sample_manifest import row_exposure_times
from gaussray.render.aov.files import neighbour_cameras, with_label_files
from gaussray.render.aov.labeller import INTEGER_LABELS, PICTURE_LABELS, Labeller
from gaussray.render.dataset import check_dataset
from gaussray.render.develop import sensor_of, sensor_values
from gaussray.render.job import RenderJob
from gaussray.render.options import NO_SENSOR
from gaussray.render.picture import render
from gaussray.render.randomize.generate import Sample, SharedRenderers, draw_sample
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.torch.tensors import (
    Item,
    as_tensor,
    camera_tensors,
    channels_first,
    drawn_tensors,
    pixel_times,
)


class _FrameJob(NamedTuple):
    """A frame to render: its sample, the records of its pictures (its own, and those of the ground
    truth that is among the labels), and those of the frames before and after."""

    sample: Sample
    records: Sequence[FrameRecord]
    neighbours: tuple[Camera | None, Camera | None]


class RenderedFrames(IterableDataset[Item]):
    """Frames of cameras that are drawn from distributions, rendered while they are read.

    The samples are those of `gaussray render` with the same words: sample 17 of this dataset is
    sample 17 of the one that the command writes, and depends on `dataset.seed` and 17 alone. Items
    are like those of `SavedFrames`; `light` is that of the sensor before it is encoded and clipped.

    Args:
        words: the words of the command, such as `["scene=RUN", "sample=cameras"]`; `labels=[...]`
            adds labels. `out` and `format` are ignored.
        begin: index of the first sample.
        count: number of samples; None for a stream without end.
        on_device: whether pictures stay on the device that JAX renders on, from where PyTorch gets
            them without a copy (DLPack). Each form of lens, aperture and shutter then has a program
            of its own (`gaussray.render`). Otherwise they are in host memory, several frames are
            rendered at once on all devices, and clips and `render.error` are possible.

    A worker process of a `DataLoader` renders every n-th sample; JAX needs it to be started by
    `multiprocessing_context="spawn"`. Without workers, JAX itself uses all cores and devices.

    Raises:
        ValueError: A word is no key of the command, or a sample is impossible.
    """

    def __init__(
        self,
        words: Sequence[str],
        *,
        begin: int = 0,
        count: int | None = None,
        on_device: bool = False,
    ):
        for name, number in (("begin", begin), ("count", count or 0)):
            if number < 0:
                raise ValueError(f"{name} must be at least 0, got {number}.")
        self.words, self.begin, self.count, self.on_device = tuple(words), begin, count, on_device
        compose_config("render", self.words)

    @functools.cached_property
    def _source(self) -> tuple[SampleSource, SharedRenderers]:
        """What samples are drawn from, and the renderers that they share."""
        cfg = compose_config("render", self.words)
        return sample_source(cfg, self.words), SharedRenderers(None)

    def __getstate__(self) -> dict[str, Any]:
        """What a worker process gets: the words, from which it makes its own renderers."""
        return {name: value for name, value in vars(self).items() if name != "_source"}

    def __iter__(self) -> Iterator[Item]:
        frame_jobs = (
            frame_job for index in self._indices() for frame_job in self._frame_jobs(index)
        )
        # Frames of one renderer are rendered ahead of the one that is read.
        for _, group in itertools.groupby(
            frame_jobs, key=lambda frame_job: _renderer_key(frame_job.sample.job)
        ):
            yield from self._items(group)

    def _indices(self) -> Iterable[int]:
        """The indices of this process's samples."""
        worker = get_worker_info()
        first, step = (worker.id, worker.num_workers) if worker else (0, 1)
        if self.count is None:
            return itertools.count(self.begin + first, step)
        return range(self.begin + first, self.begin + self.count, step)

    def _frame_jobs(self, index: int) -> Iterator[_FrameJob]:
        """The frames of a sample."""
        source, _ = self._source
        sample = draw_sample(index, source.distributions, source.make_job, options=source.options)
        job = sample.job
        records = with_label_files(job.records, job.dataset.labels)
        check_dataset(job.scene, records, job.dataset)
        frames, count = records[: len(job.records)], len(job.records)
        near = neighbour_cameras(frames)
        for i, record in enumerate(frames):
            yield _FrameJob(sample, [record, *records[count + i :: count]], near[record.file_path])

    def _items(self, frame_jobs: Iterator[_FrameJob]) -> Iterator[Item]:
        """The items of frames that share a renderer."""
        first, waiting = next(frame_jobs), deque[_FrameJob]()
        renderer = self._source[1].renderer(first.sample.job)

        def cameras() -> Iterator[Camera]:
            for frame_job in itertools.chain([first], frame_jobs):
                waiting.append(frame_job)
                sensor = frame_job.sample.job.dataset.sensor
                for record in frame_job.records:
                    yield with_chromatic(record.camera, sensor_of(record, sensor).chromatic)

        job = first.sample.job
        if self.on_device:
            pictures = (
                render(_one_segment(job), camera, options=job.options, trace=job.trace).color
                for camera in cameras()
            )
        else:
            pictures = (frame.color for frame in renderer.render_frames(cameras()))
        labeller = _labeller(job)
        for light in pictures:
            frame_job = waiting.popleft()
            item = _item(frame_job, light)
            for record in frame_job.records[1:]:
                item[record.effect] = _light(record, next(pictures), job)
            yield item | _labels(labeller, frame_job)


def _one_segment(job: RenderJob) -> Scene:
    """The scene of a job; a ValueError if it is a clip of several segments."""
    if isinstance(job.scene, Clip):
        raise ValueError(
            f"on_device must be False for a scene of {len(job.scene.segments)} segments, got True."
        )
    return job.scene


def _labeller(job: RenderJob) -> Labeller | None:
    """What computes the labels of a job, if it has any."""
    if not job.dataset.labels:
        return None
    return Labeller(_one_segment(job), options=job.options, trace=job.trace)


def _renderer_key(job: RenderJob) -> tuple[Any, ...]:
    """What the frames of one renderer share."""
    return id(job.scene), job.options, job.trace, tuple(job.dataset.labels)


def _item(frame_job: _FrameJob, light: Array | np.ndarray) -> Item:
    """The picture of a frame and what is known of its camera."""
    record = frame_job.records[0]
    camera = record.camera
    size = camera.film.width, camera.film.height
    times = pixel_times(row_exposure_times(camera), camera.shutter.direction, size)
    return {
        "light": _light(record, light, frame_job.sample.job),
        **camera_tensors(camera_to_world(camera), float(camera.time), times),
        "sample": torch.tensor(frame_job.sample.index),
        "drawn": drawn_tensors(frame_job.sample.values),
    }


def _light(record: FrameRecord, light: Array | np.ndarray, job: RenderJob) -> torch.Tensor:
    """The linear light [3, h, w] of a picture, developed by its sensor."""
    sensor = sensor_of(record, job.dataset.sensor)
    if sensor != NO_SENSOR:
        developed = sensor_values(record, jnp.asarray(light), sensor)
        light = developed if not isinstance(light, np.ndarray) else np.asarray(developed)
    return channels_first(as_tensor(light))


def _labels(labeller: Labeller | None, frame_job: _FrameJob) -> Item:
    """The labels of a frame but its ground truth pictures."""
    names = [name for name in frame_job.sample.job.dataset.labels if name not in PICTURE_LABELS]
    if not names or labeller is None:
        return {}
    before, after = frame_job.neighbours
    values = labeller(frame_job.records[0].camera, names, before=before, after=after)
    kinds = {name: np.int32 if name in INTEGER_LABELS else np.float32 for name in names}
    return {name: channels_first(as_tensor(x.astype(kinds[name]))) for name, x in values.items()}
