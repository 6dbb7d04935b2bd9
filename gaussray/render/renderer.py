"""Stage 2: renders pictures of a scene, frame after frame."""

import itertools
import threading
import time as clock
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array

from gaussray.camera.camera import Camera
from gaussray.io.plain_values import to_device
from gaussray.io.validate import check_kind
from gaussray.render.compiled import ProgramSettings, render_frames, render_part
from gaussray.render.frame import (
    DevelopedFrame,
    Frame as Frame,
    channels,
    join_rows,
    mean_until_error,
    merge_segments,
)
from gaussray.render.frame_batch import (
    MOST_IN_FLIGHT,
    FrameBatch,
    PlacedPart,
    TracedPart,
    develop_frames,
    fetch_pictures,
)
from gaussray.render.list_sizes import NO_LISTS, enlarge_program_capacity
from gaussray.render.measured_capacity import single_program_capacity, staged_capacity
from gaussray.render.options import RenderOptions
from gaussray.render.parts import (
    Part,
    interleaved_parts,
    pixels_part,
    strip_part,
    strip_plan,
    strip_tops,
    whole_picture,
)
from gaussray.render.picture_programs import render_staged, uses_stages
from gaussray.render.views import FrameView, FrameViews, mark_single_batch
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import SCENE_RULE, Clip, segment_edges, segments_of
from gaussray.scene.spare_rows import with_spare_rows
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.shard import mesh as device_mesh
from gaussray.tracer.trace import Report
from gaussray.tracer.traverse import Capacity, capacity_of_device


_T = TypeVar("_T")


class Renderer:
    """Renders frames of one scene. List sizes are measured once and kept.

    If a list overflows, its size is raised and the frame is rendered again. Of a clip, every ray
    sees the segment that shows its time; a frame across several segments is rendered once for each.

    Args:
        scene: the scene.
        options: how pictures are sampled; default `RenderOptions()`, 4 rays a pixel.
        trace: how rays are traced; default `TraceOptions()`.
        devices: number of devices; None is all.
    """

    def __init__(
        self,
        scene: Scene | Clip,
        *,
        options: RenderOptions | None = None,
        trace: TraceOptions | None = None,
        devices: int | None = None,
    ):
        check_kind("scene", scene, (Scene, Clip), SCENE_RULE)
        check_kind("options", options, (RenderOptions, type(None)), "gaussray.RenderOptions(...)")
        check_kind("trace", trace, (TraceOptions, type(None)), "gaussray.TraceOptions(...)")
        self.scene = scene
        self.scenes = segments_of(scene)
        self.options = options or RenderOptions()
        self.trace = trace or TraceOptions()
        self.mesh = device_mesh(devices)
        self._padded = [with_spare_rows(scene) for scene in self.scenes]
        flat = [jax.tree.flatten(scene) for scene in self._padded]
        self._flat = [(self._on_all_devices(leaves), structure) for leaves, structure in flat]
        # By `FrameBatch.capacity_key`; threads that fetch pictures enlarge what was too short.
        self._capacity: dict[tuple, Capacity] = {}
        self._enlarging = threading.Lock()
        self._staged = uses_stages(self.options, self.trace)
        self._parts: dict[tuple, PlacedPart] = {}
        # Keys and capacities whose programs have been compiled.
        self._compiled: set[tuple[tuple, Capacity]] = set()
        self._views = FrameViews(self.scenes, segment_edges(scene), self.options)

    def __call__(self, camera: Camera) -> Frame:
        """Render one frame, its rays divided among the devices.

        Raises:
            ValueError: The camera is traced, inside `jit`, `grad` or `vmap`, or is no camera.
        """
        check_kind("camera", camera, Camera, "a gaussray.Camera (that of a view: view.camera)")
        if any(isinstance(x, Tracer) for x in jax.tree.leaves(camera)):
            raise ValueError(
                "a Renderer takes cameras of numbers, not inside of jit, grad or vmap: there, use "
                "gaussray.render(scene, camera), which is a pure function."
            )
        if self.options.error:
            return mean_until_error(
                map(partial(self._render_one, camera), itertools.count()), self.options
            )
        return self._render_one(camera)

    def _render_one(self, camera: Camera, batch: int | None = None) -> Frame:
        """One frame, of the plain samples or of a batch of them."""
        views = self._views.views([camera], batch)
        return merge_segments(
            [self._finish(self._begin([view], split_frame=True))[0] for view in views]
        )

    def render_frames(self, cameras: Iterable[Camera]) -> Iterator[Frame]:
        """Render many frames: each device renders one, and the next is begun before it is fetched.

        Threads fetch the pictures, because allocating memory for a picture takes the host longer
        than a GPU takes to render it. With `render.error` one frame is finished before the next is
        begun.

        Args:
            cameras: the cameras.

        Yields:
            A frame for each camera, in order; `Frame.seconds` counts from its beginning.
        """
        if self.options.error:
            yield from map(self, cameras)
            return
        parts: list[Frame] = []
        for view, part in self._render_frames(cameras, lambda batch: partial(self._finish, batch)):
            parts.append(part)
            if view.last:
                yield merge_segments(parts)
                parts = []

    def render_developed(
        self, cameras: Iterable[Camera], develop: Callable[[int, Array], Any]
    ) -> Iterator[DevelopedFrame]:
        """Render many frames (`render_frames`), of which only what `develop` returns is fetched.

        Args:
            cameras: the cameras.
            develop: from a frame's number, from 0, and its values on a device, [height, width,
                channels], of which the first three are linear light; a tree of arrays.

        Yields:
            What `develop` returned, on the host, and the frame's samples and error.
        """
        if self.options.error or len(self.scenes) > 1:
            for number, frame in enumerate(self.render_frames(cameras)):
                values = jax.device_get(develop(number, jnp.asarray(frame.color)))
                yield DevelopedFrame(values, frame.samples, frame.error)
            return
        numbers = itertools.count()

        def begin(batch: FrameBatch) -> Callable[[], list[DevelopedFrame]]:
            own = [partial(develop, next(numbers)) for _ in batch.views]
            # A device would do it later only behind the frames that are begun in between.
            return partial(self._finish_developed, batch, own, develop_frames(batch, own))

        yield from (frame for _, frame in self._render_frames(cameras, begin))

    def _render_frames(
        self, cameras: Iterable[Camera], finish: Callable[[FrameBatch], Callable[[], list[_T]]]
    ) -> Iterator[tuple[FrameView, _T]]:
        """What every segment shows of every frame; a thread runs what `finish` returns."""
        waiting: deque[tuple[list[FrameView], Future[list[_T]]]] = deque()
        with ThreadPoolExecutor(MOST_IN_FLIGHT) as pool:
            for views, lone in mark_single_batch(
                self._views.batches(self._views.views(cameras), self.mesh.size)
            ):
                batch = self._begin(views, split_frame=self.mesh.size == 1 or lone)
                waiting.append((views, pool.submit(finish(batch))))
                # After a compilation lists may turn out too short: better for one frame than eight.
                while waiting and (len(waiting) > batch.in_flight or batch.compiled):
                    begun, frames = waiting.popleft()
                    yield from zip(begun, frames.result(), strict=True)
            for begun, frames in waiting:
                yield from zip(begun, frames.result(), strict=True)

    def _begin(self, views: list[FrameView], *, split_frame: bool) -> FrameBatch:
        """Frames that are being rendered, in one part, in strips or in chunks of rows."""
        film = views[0].camera.film
        if views[0].keys:
            scene = self._padded[views[0].segment]
            rows, trace = strip_plan(film, self.options, self.trace, scene.count)
        else:
            rows, trace = min(self.options.chunk_rows, film.height), self.trace
        layout = None if self._staged else views[0].layout
        batch = FrameBatch(views, split_frame, rows, trace, layout)
        for top in strip_tops(film.height, rows):
            if batch.parts and jax.default_backend() == "cpu":
                # Parts under way together share the cores' threads, where the sums over devices of
                # one can wait for those of another without end.
                jax.block_until_ready(batch.parts[-1].values)
            batch.parts.append(TracedPart(top, *self._launch(batch, top)))
        return batch

    def _launch(self, batch: FrameBatch, top: int) -> tuple[PlacedPart, Array, Report]:
        """A part with its values and report, under way."""
        key = batch.capacity_key
        placed = self._part(top, batch)
        if key not in self._capacity:
            self._capacity[key] = self._measure(batch, placed.part, placed.trace)
        settings = self._settings(batch, placed.trace, self._capacity[key])
        batch.compiled |= (key, settings.capacity) not in self._compiled
        self._compiled.add((key, settings.capacity))
        layout = batch.views[0].layout
        leaves, structure = self._flat[batch.views[0].segment]
        rows = self._rows(batch)
        if self._staged:
            return placed, *render_staged(structure, layout, settings, (leaves, rows, placed.part))
        program = render_part if batch.split_frame else render_frames
        return placed, *program(structure, layout, settings)(leaves, rows, placed.part)

    def _settings(
        self, batch: FrameBatch, trace: TraceOptions, capacity: Capacity
    ) -> ProgramSettings:
        return ProgramSettings(capacity, batch.keys, self.options, trace, self.mesh)

    def _rows(self, batch: FrameBatch) -> np.ndarray:
        """The numbers of the camera of every device. A device without a frame of its own repeats
        the last."""
        rows = [view.row for view in batch.views]
        if batch.split_frame and not self._staged:
            return rows[0]
        return np.stack(rows + rows[-1:] * (self.mesh.size - len(rows)))

    def _finish(self, batch: FrameBatch) -> list[Frame]:
        """The frames of a batch; parts whose lists were too short are rendered again."""
        film, hits, count = batch.film, 0, len(batch.views)
        pieces = []
        for top, placed, values, report in batch.parts:
            while np.asarray(report.dropped).any():
                needed, key = report.largest_needed(), batch.capacity_key
                with self._enlarging:
                    self._capacity[key] = enlarge_program_capacity(
                        self._capacity[key], needed, staged=self._staged
                    )
                    _, values, report = self._launch(batch, top)
            pictures = [
                x.reshape(batch.rows, film.width, 5) for x in fetch_pictures(values, placed, count)
            ]
            pieces.append((top, pictures))
            hits += int(np.asarray(report.hits).sum())
        seconds = (clock.monotonic() - batch.began) / count
        return [
            Frame(*channels(x), seconds, hits // count, batch.compiled, self.options.samples)
            for x in (
                join_rows(film, [(top, pictures[i]) for top, pictures in pieces])
                for i in range(count)
            )
        ]

    def _finish_developed(
        self, batch: FrameBatch, develop: list[Callable[[Array], Any]], values: list[Any]
    ) -> list[DevelopedFrame]:
        """The developed frames of a batch; `values` of incomplete ones are made anew."""
        if not values or batch.incomplete:
            frames = zip(develop, self._finish(batch), strict=True)
            values = [f(jnp.asarray(frame.color)) for f, frame in frames]
        return [DevelopedFrame(x, self.options.samples) for x in jax.device_get(values)]

    def _part(self, top: int, batch: FrameBatch) -> PlacedPart:
        """The part of a batch whose first row is `top`, on the devices."""
        film, trace = batch.film, batch.trace
        size = film.width, film.height, top, batch.rows
        key = (*size, batch.keys == 0, trace.levels, batch.split_frame)
        if key not in self._parts:
            self._parts[key] = self._make_part(top, batch)
        placed, view = self._parts[key], batch.views[0]
        number = None if view.number is None else to_device(view.number, jnp.int32)
        share, number = self._by_device((view.share, number))
        return placed._replace(part=replace(placed.part, share=share, batch=number))

    def _make_part(self, top: int, batch: FrameBatch) -> PlacedPart:
        film, trace, slots = batch.film, batch.trace, None
        if not batch.keys:
            y, x = np.mgrid[top : top + batch.rows, : film.width]
            part, trace = pixels_part(film, (y * film.width + x).T.reshape(-1), trace, top)
        elif self._staged and batch.split_frame and self.mesh.size > 1:
            part, trace, slots = interleaved_parts(film, trace, self.mesh.size, batch.rows, top)
            part, slots = jax.device_put(part, self._split()), np.asarray(slots)
            return PlacedPart(part, trace, slots)
        elif batch.rows == film.height:
            part, trace = whole_picture(film, trace)
        else:
            part, trace = strip_part(film, batch.rows, trace, top)
        return PlacedPart(self._by_device(part), trace)

    def _by_device(self, tree):
        """Arrays that are the same for every device, as the programs take them."""
        if not self._staged:
            return self._on_all_devices(tree)
        # On the host: on the device it would take a program for every shape.
        tree = jax.tree.map(lambda x: np.stack([np.asarray(x)] * self.mesh.size), tree)
        tree = jax.tree.map(to_device, tree)
        return tree if self.mesh.size == 1 else jax.device_put(tree, self._split())

    def _split(self) -> NamedSharding:
        """Arrays with a leading axis of devices."""
        return NamedSharding(self.mesh, PartitionSpec("rays"))

    def _on_all_devices(self, tree):
        """On every device, once for all frames."""
        if self.mesh.size == 1:
            return tree
        return jax.device_put(tree, NamedSharding(self.mesh, PartitionSpec()))

    def _measure(self, batch: FrameBatch, part: Part, trace: TraceOptions) -> Capacity:
        """The list capacity that a part of a batch needs."""
        view, settings = batch.views[0], self._settings(batch, trace, NO_LISTS)
        if self._staged:
            leaves, structure = self._flat[view.segment]
            arguments, dtype = (leaves, self._rows(batch), part), view.camera.time.dtype
            return staged_capacity(structure, view.layout, settings, arguments, dtype)
        scene, part = self._padded[view.segment], jax.device_get(part)
        capacity = single_program_capacity(scene, view.camera, part, settings=settings)
        return capacity_of_device(capacity, self.mesh.size if batch.split_frame else 1)
