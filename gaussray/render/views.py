"""The views of a render: cameras on the host, with key states and segments, in batches."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import SIDEWAYS, time_window
from gaussray.render.camera_layout import CameraLayout, pack_camera
from gaussray.render.options import RenderOptions
from gaussray.render.segments import SegmentRays, segment_rays
from gaussray.scene.scene import Scene, key_count


# Cameras that are fetched from a device at once.
_FETCHED = 64


class FrameView(NamedTuple):
    """One frame of one segment of a scene.

    Args:
        camera: the camera, on the host.
        row: all numbers of the camera.
        layout: layout of the row.
        keys: number of key states; 0 is chunks of rows.
        segment: the segment of the scene.
        share: the rays that the segment shows; None is all of them.
        last: whether this is the frame's last segment.
        number: the batch of samples; None is `sobol_samples`.
    """

    camera: Camera
    row: Float[np.ndarray, " numbers"]
    layout: CameraLayout
    keys: int
    segment: int = 0
    share: SegmentRays | None = None
    last: bool = True
    number: int | None = None

    def is_like(self, other: "FrameView") -> bool:
        """Whether one call of one program serves both."""
        whole = self.share is None and other.share is None
        alike = self.layout == other.layout and self.keys == other.keys
        return whole and alike and self.segment == other.segment


class FrameViews:
    """Makes the views of frames of one scene, and batches of views that one program serves."""

    def __init__(
        self, scenes: Sequence[Scene], edges: Float[np.ndarray, " edges"], options: RenderOptions
    ):
        self.scenes, self.edges, self.options = scenes, edges, options
        # Key states by segment and span: a frame need not ask the device for the timestamps.
        self._counts: dict[tuple[int, float], int] = {}

    def views(self, cameras: Iterable[Camera], number: int | None = None) -> Iterator[FrameView]:
        """The views of frames: one for every segment that a frame shows.

        Args:
            cameras: the cameras, which are fetched from the device many at a time.
            number: the batch of samples; None is `sobol_samples`.
        """
        cameras = iter(cameras)
        while fetched := list(itertools.islice(cameras, _FETCHED)):
            for camera in jax.device_get(fetched):
                row, layout = pack_camera(camera)
                segments = segment_rays(camera, self.edges, self.options.samples, number)
                for segment, share in segments:
                    keys, last = self._keys(camera, segment, share), segment == segments[-1][0]
                    yield FrameView(camera, row, layout, keys, segment, share, last, number)

    def batches(self, views: Iterable[FrameView], devices: int) -> Iterator[list[FrameView]]:
        """Group consecutive views that one program can render, at most one per device.

        Args:
            views: the views.
            devices: number of devices.
        """
        batch: list[FrameView] = []
        for view in views:
            if batch and (len(batch) == devices or not batch[0].is_like(view)):
                yield batch
                batch = []
            batch.append(view)
        if batch:
            yield batch

    def _keys(self, camera: Camera, segment: int, share: SegmentRays | None) -> int:
        """Key states for what a segment shows of a frame; 0 where chunks of rows are called for."""
        span = _time_span(camera) if share is None else float(share.span[1] - share.span[0])
        if span == 0:
            return 1
        if not self.options.chunk_rows:
            key = segment, span
            if key not in self._counts:
                count = self.options.keys or key_count(self.scenes[segment], span)
                self._counts[key] = count
            return self._counts[key]
        if camera.shutter.direction in SIDEWAYS:
            raise ValueError(
                "render.chunk_rows must be 0 for a shutter that reads columns, as "
                f"{camera.shutter.direction} does: key states suit any direction."
            )
        if self.options.chunk_rows > 1 and camera.shutter.row_times is not None:
            raise ValueError(
                "render.chunk_rows must be 0 or 1 for a shutter with row_times, got "
                f"{self.options.chunk_rows}: neighbouring rows may be read at distant times."
            )
        return 0


def mark_single_batch(batches: Iterable[list[FrameView]]) -> Iterator[tuple[list[FrameView], bool]]:
    """Batches, each with whether it is the only one and holds a single frame."""
    batches = iter(batches)
    first, second = next(batches, None), next(batches, None)
    if first is not None:
        yield first, second is None and len(first) == 1
    if second is not None:
        yield second, False
    yield from ((batch, False) for batch in batches)


def _time_span(camera: Camera) -> float:
    """How long the camera looks, from the first ray's time to the last one's."""
    film = camera.film
    earliest, latest = time_window(jax.device_get(camera.shutter), (film.width, film.height))
    return latest - earliest
