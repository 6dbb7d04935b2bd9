"""Previews: pictures from compiled programs; missing programs are compiled in the background."""

import dataclasses
import math
import threading
import time as clock
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import time_window
from gaussray.render.camera_layout import CameraLayout, pack_camera
from gaussray.render.compiled import ProgramSettings, render_part, render_pieces
from gaussray.render.list_sizes import NO_LISTS, enlarge_program_capacity, round_capacity
from gaussray.render.measured_capacity import single_program_capacity, staged_capacity
from gaussray.render.options import RenderOptions
from gaussray.render.parts import Part, interleaved_parts, pixels_part, whole_picture
from gaussray.render.picture_programs import StageArguments, render_staged, uses_stages
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, segment_edges, segments_of
from gaussray.scene.spare_rows import with_spare_rows
from gaussray.tracer.options import TraceOptions, grid_levels
from gaussray.tracer.shard import mesh as device_mesh
from gaussray.tracer.trace import Report
from gaussray.tracer.traverse import Capacity


# Lists are this many times as long as the first picture needs, because the next ones differ.
_HEADROOM = 2.0
# A picture with up to this many times the pixels of another takes over the length of its lists.
_NEAR = 5.0


class Preview(NamedTuple):
    """A preview, possibly still on the GPU: red, green, blue, alpha and distance of every pixel,
    render time in milliseconds, number of hits, and list entries `dropped` because lists were too
    short; a program with longer lists is then being compiled."""

    values: Float[Array, "pixels 5"] | Float[np.ndarray, "pixels 5"]
    size: tuple[int, int]
    milliseconds: float
    hits: int
    dropped: int


class _Program(NamedTuple):
    """A compiled program with its list capacity and the picture that it traces."""

    call: Callable[..., tuple[Array, Report]]
    capacity: Capacity
    picture: "_Picture"


class _Picture(NamedTuple):
    """The part of a picture that a program traces, and how; with several devices, `slots` is where
    each pixel lies in their joint output."""

    part: Part
    trace: TraceOptions
    slots: np.ndarray | None = None


class _Key(NamedTuple):
    """What a program is compiled for: camera layout, picture size, key states, rays per pixel,
    segment of the scene, and whether it traces a single pixel (`probe`)."""

    layout: CameraLayout
    size: tuple[int, int]
    keys: int
    samples: int
    segment: int
    probe: bool


class PreviewRenderer:
    """Renders previews of one scene: on a CPU with all cores, elsewhere on one device.

    Camera numbers are inputs of the programs, so moving, focusing or changing the aperture compiles
    nothing. Where pictures are rendered in stages, another lens compiles only its rays. Of a
    segmented scene, all rays see the segment at the frame's time.
    """

    def __init__(
        self, scene: Scene | Clip, *, options: RenderOptions, trace: TraceOptions, keys: int
    ):
        self._edges, self.trace, self.keys = segment_edges(scene), trace, keys
        self._like = dataclasses.replace(options, chunk_rows=0, error=0.0)
        self.scenes = [with_spare_rows(one) for one in segments_of(scene)]
        self._staged = uses_stages(self._like, trace)
        self._mesh = device_mesh(None if jax.default_backend() == "cpu" else 1)
        self._flat = [jax.tree.flatten(jax.tree.map(jax.numpy.asarray, s)) for s in self.scenes]
        several = self._mesh.size > 1
        self._shared = [self._on_all_devices(leaves) for leaves, _ in self._flat if several]
        self._programs: dict[_Key, _Program] = {}
        self._queued: set[_Key] = set()
        self._lock = threading.Condition()
        self._builder = ThreadPoolExecutor(1, thread_name_prefix="compile")
        self._closed = False
        self.failure: Exception | None = None

    @property
    def compiling(self) -> int:
        """Number of programs that are being compiled or are queued."""
        return len(self._queued)

    def __call__(self, camera: Camera, samples: int) -> Preview | None:
        """The preview, or None while its program is being compiled."""
        row, key = self._key(camera, samples)
        program = self._programs.get(key)
        if program is None:
            self._queue(key, camera)
            return None
        begin = clock.monotonic()
        values, report = self._run(program, key, row)
        spent = 1000 * (clock.monotonic() - begin)
        if report.dropped.any():
            self._queue(key, camera, self._enlarged_capacity(program, report))
        hits, dropped = int(report.hits.sum()), int(report.dropped.sum())
        return Preview(values, key.size, spent, hits, dropped)

    def probe(self, camera: Camera, pixel: tuple[int, int]) -> tuple[float, float]:
        """Alpha and distance along the ray of a pixel, in scene units.

        Traces one ray. Its program is compiled at the first call.

        Args:
            camera: the camera, without an aperture (`render.focus.without_aperture`), so that the
                ray is the pixel's chief ray.
            pixel: column and row of the pixel.
        """
        row, key = self._key(camera, 1, probe=True)
        self._wait_for(key)
        if key not in self._programs:
            self._build(key, camera)
        at = np.array([pixel[1] * key.size[0] + pixel[0]])
        pixel_only = self._single_device_part(*pixels_part(camera.film, at, self.trace))
        while True:
            program = self._programs[key]._replace(picture=pixel_only)
            values, report = self._run(program, key, row)
            if not report.dropped.any():
                numbers = np.asarray(values)[0]
                return float(numbers[3]), float(numbers[4])
            self._build(key, camera, self._enlarged_capacity(program, report))

    def has(self, camera: Camera, samples: int) -> bool:
        """Whether the program for such a preview is compiled.

        Args:
            camera: the camera of the preview. Its numbers do not count, but for its time (the
                segment of the scene) and for whether its shutter takes any time.
            samples: rays per pixel.
        """
        return self._key(camera, samples)[1] in self._programs

    def prepare(self, camera: Camera, samples: int, probe: bool = False) -> None:
        """Compile the program for such previews in the background, if it is missing.

        Args:
            camera: a camera of such previews (`has`); the program's lists fit its picture.
            samples: rays per pixel; 1 for `probe`.
            probe: whether to compile the program of the method `probe` instead.
        """
        key = self._key(camera, samples, probe)[1]
        if key not in self._programs:
            self._queue(key, camera)

    def close(self) -> None:
        """Stop compiling."""
        with self._lock:
            self._closed = True
        self._builder.shutdown(wait=False, cancel_futures=True)

    def _key(self, camera: Camera, samples: int, probe: bool = False):
        camera = jax.device_get(camera)
        row, layout = pack_camera(camera)
        film = camera.film
        begin, end = time_window(camera.shutter, (film.width, film.height))
        segment = int(np.searchsorted(self._edges, float(camera.time), side="right"))
        moves = end > begin and self.scenes[segment].deformation is not None
        keys = self.keys if moves else 1
        return row, _Key(layout, (film.width, film.height), keys, samples, segment, probe)

    def _run(self, program: _Program, key: _Key, row: np.ndarray):
        slots = program.picture.slots
        values, report = program.call(*self._arguments(key, program.picture, row))
        if slots is not None:
            values, report = jax.device_get((values, report))
            return values.reshape(-1, 5)[slots], report
        return jax.block_until_ready((values[0] if self._staged else values, report))

    def _arguments(self, key: _Key, picture: _Picture, row: np.ndarray) -> StageArguments:
        """Leaves of the scene, numbers of the camera, and part, on the devices that render."""
        one_device = picture.slots is None
        leaves = self._flat[key.segment][0] if one_device else self._shared[key.segment]
        if self._staged:
            row = np.tile(row, (1 if one_device else self._mesh.size, 1))
        return leaves, row, picture.part

    def _on_all_devices(self, tree):
        """Copy to all devices that render."""
        return jax.device_put(tree, NamedSharding(self._mesh, PartitionSpec()))

    def _similar_capacity(self, key: _Key, levels: int) -> Capacity | None:
        """List capacity of a program for a picture of this size, whose stages other lenses share,
        or scaled from one of nearly this size. None without such a program. Measuring it would
        need another compilation."""
        sizes = [
            (math.prod(key.size) / math.prod(other.size), program.capacity)
            for other, program in self._programs.items()
            if other.segment == key.segment
            and other.probe == key.probe
            and len(program.capacity.cells) == levels
        ]
        sizes = [known for known in sizes if known[0] <= _NEAR]
        if not sizes:
            return None
        ratio, whole = min(sizes, key=lambda known: (abs(math.log(known[0])), -known[1].pairs))
        ratio = max(ratio, 1)
        cells = tuple(math.ceil(ratio * count) for count in whole.cells)
        scaled = Capacity(cells, math.ceil(ratio * whole.pairs), whole.slots, whole.transient)
        return round_capacity(scaled) if self._staged else scaled

    def _wait_for(self, key: _Key) -> None:
        """Wait for a program that is being compiled."""
        with self._lock:
            self._lock.wait_for(lambda: key not in self._queued)

    def _queue(self, key: _Key, camera: Camera, capacity: Capacity | None = None) -> None:
        with self._lock:
            if key in self._queued or self._closed:
                return
            self._queued.add(key)
        self._builder.submit(self._compile, key, camera, capacity)

    def _compile(self, key: _Key, camera: Camera, capacity: Capacity | None) -> None:
        try:
            self._build(key, camera, capacity)
        except Exception as error:
            self.failure = error
        finally:
            with self._lock:
                self._queued.discard(key)
                self._lock.notify_all()

    def _build(self, key: _Key, camera: Camera, capacity: Capacity | None = None) -> None:
        """Compile the program of a key, by default with the list capacity that the camera needs."""
        picture = self._picture(key, camera)
        levels = grid_levels(picture.trace, camera.time.dtype)
        capacity = capacity or self._similar_capacity(key, levels)
        if capacity is None:
            capacity = self._measure_capacity(key, camera, picture)
        program = _Program(self._call(key, picture, capacity), capacity, picture)
        self._run(program, key, pack_camera(jax.device_get(camera))[0])
        self._programs[key] = program

    def _call(
        self, key: _Key, picture: _Picture, capacity: Capacity
    ) -> Callable[..., tuple[Array, Report]]:
        """A function of the leaves of the scene, the numbers of a camera, and the part."""
        structure, settings = self._flat[key.segment][1], self._settings(key, picture, capacity)
        if self._staged:
            return lambda *arguments: render_staged(structure, key.layout, settings, arguments)
        make = render_part if picture.slots is None else render_pieces
        return make(structure, key.layout, settings)

    def _measure_capacity(self, key: _Key, camera: Camera, picture: _Picture) -> Capacity:
        """The list capacity that a camera needs."""
        part, settings = picture.part, self._settings(key, picture, NO_LISTS)
        if self._staged:
            structure = self._flat[key.segment][1]
            row = pack_camera(jax.device_get(camera))[0]
            arguments = self._arguments(key, picture, row)
            return staged_capacity(structure, key.layout, settings, arguments, camera.time.dtype)
        if picture.slots is not None:
            part = jax.tree.map(lambda x: x[0], jax.device_get(part))
        return single_program_capacity(
            self.scenes[key.segment], camera, part, settings=settings, headroom=_HEADROOM
        )

    def _enlarged_capacity(self, program: _Program, report: Report) -> Capacity:
        """List capacity enlarged to what a picture needed."""
        needed = report.largest_needed()
        return enlarge_program_capacity(
            program.capacity, needed, staged=self._staged, headroom=_HEADROOM
        )

    def _settings(self, key: _Key, picture: _Picture, capacity: Capacity) -> ProgramSettings:
        options = dataclasses.replace(self._like, samples=key.samples)
        mesh = None if picture.slots is None else self._mesh
        return ProgramSettings(capacity, key.keys, options, picture.trace, mesh, quick=False)

    def _picture(self, key: _Key, camera: Camera) -> _Picture:
        """What a program traces."""
        if key.probe:
            middle = key.size[1] // 2 * key.size[0] + key.size[0] // 2
            return self._single_device_part(
                *pixels_part(camera.film, np.array([middle]), self.trace)
            )
        if self._mesh.size == 1:
            return self._single_device_part(*whole_picture(camera.film, self.trace))
        part, trace, slots = interleaved_parts(camera.film, self.trace, self._mesh.size)
        shared = jax.device_put(part, NamedSharding(self._mesh, PartitionSpec("rays")))
        return _Picture(shared, trace, np.asarray(slots))

    def _single_device_part(self, part: Part, trace: TraceOptions) -> _Picture:
        """A part for one device; programs in stages take a leading axis of devices."""
        return _Picture(jax.tree.map(lambda x: x[None], part) if self._staged else part, trace)
