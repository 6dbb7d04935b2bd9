"""Frames that are rendered together, and their pictures as they come from the devices."""

import time as clock
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from gaussray.render.camera_layout import CameraLayout
from gaussray.render.parts import Part
from gaussray.render.views import FrameView
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.trace import Report


# Batches of frames that are begun before the first of them has been fetched, and their bytes.
MOST_IN_FLIGHT, _BYTES = 8, 2 * 1024**3


class PlacedPart(NamedTuple):
    """A part of a picture on the devices.

    Args:
        part: the pixels.
        trace: options of the tracer.
        slots: place of each pixel among the slots of all devices; None if every device has whole
            pictures.
    """

    part: Part
    trace: TraceOptions
    slots: np.ndarray | None = None


class TracedPart(NamedTuple):
    """A part that is being rendered.

    Args:
        top: its first row.
        placed: the part on the devices.
        values: values of its pixels.
        report: the trace's report.
    """

    top: int
    placed: PlacedPart
    values: Array
    report: Report


class FrameBatch:
    """Frames that are being rendered: one on each device, or one whose rays the devices share.

    Args:
        views: the frames; they have one film, layout and segment, and one number of key states.
        split_frame: whether the devices share one frame.
        rows: number of rows that are traced at once.
        trace: options of the tracer.
        layout: layout of the cameras' numbers; None where cameras of any layout share a list
            capacity.

    Attributes:
        parts: the parts of the frames, as they are begun.
        capacity_key: batches with equal keys share a list capacity.
    """

    def __init__(
        self,
        views: list[FrameView],
        split_frame: bool,
        rows: int,
        trace: TraceOptions,
        layout: CameraLayout | None,
    ):
        self.views, self.split_frame, self.rows, self.trace = views, split_frame, rows, trace
        self.film, self.keys = views[0].camera.film, views[0].keys
        self.began, self.compiled = clock.monotonic(), False
        self.parts: list[TracedPart] = []
        segment = views[0].segment, views[0].share is None
        self.capacity_key = (self.film.width, rows, self.keys, layout, split_frame, *segment)

    @property
    def in_flight(self) -> int:
        """Batches like this that may be under way before one is fetched; a CPU fetches nothing."""
        if jax.default_backend() == "cpu":
            return 1
        size = len(self.views) * self.film.width * self.film.height * 5 * 4
        return min(max(_BYTES // size, 1), MOST_IN_FLIGHT)

    @property
    def incomplete(self) -> bool:
        """Whether lists were too short, so that a part must be rendered again."""
        return any(np.asarray(part.report.dropped).any() for part in self.parts)


def fetch_pictures(values: Array, placed: PlacedPart, count: int) -> list[np.ndarray]:
    """Fetch the frames of a batch, one from each device, without a further copy.

    Args:
        values: values on the devices.
        placed: the part on the devices.
        count: number of frames.
    """
    if values.ndim == 2:
        return [np.asarray(values)]
    if placed.slots is not None:
        return [np.asarray(values).reshape(-1, values.shape[-1])[placed.slots]]
    return [np.asarray(picture) for picture in _of_each_device(values, count)]


def develop_frames(batch: FrameBatch, develop: Sequence[Callable[[Array], Any]]) -> list[Any]:
    """Begin to develop the frames of a batch on their devices, right behind their programs.

    Args:
        batch: the batch, under way.
        develop: what turns the values of each frame into arrays.

    Returns:
        The arrays of each frame, under way; nothing if a device has only parts of a frame.
    """
    part, *further = batch.parts
    values, one_device = part.values, len(part.values.devices()) == 1
    if further or part.placed.slots is not None or (values.ndim == 2 and not one_device):
        return []
    frames = [values] if one_device else _of_each_device(values, len(batch.views))
    return [function(frame) for function, frame in zip(develop, frames, strict=True)]


def _of_each_device(values: Array, count: int) -> list[Array]:
    """The frames of a batch with a leading axis of devices."""
    shards = sorted(values.addressable_shards, key=lambda shard: shard.index[0].start)
    return [shard.data for shard in shards[:count]]
