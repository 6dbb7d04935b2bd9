"""Previews: pictures from compiled programs; missing programs are compiled in the background."""

import dataclasses
import math
import threading
import time as clock
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import time_window
from gaussray.render.camera_layout import CameraLayout, pack_camera
from gaussray.render.compiled import ProgramSettings, prepare_trace, render_part, render_pieces
from gaussray.render.options import RenderOptions
from gaussray.render.parts import Part, interleaved, part_of, whole_picture
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, edges_of, segments_of
from gaussray.tracer.shard import mesh as device_mesh
from gaussray.tracer.trace import Report, TraceOptions, enlarged_capacity, measure
from gaussray.tracer.traverse import Capacity


# Lists are this many times as long as the first picture needs, because the next ones differ.
_HEADROOM = 2.0
# A picture with up to this many times the pixels of another takes over the length of its lists.
_NEAR = 5.0


class Preview(NamedTuple):
    """A preview, possibly still on the GPU: red, green, blue, alpha and distance of every pixel,
    render time in milliseconds, number of hits, and list entries `dropped` because lists were too
    short; longer lists are then being compiled."""

    values: Float[Array, "pixels 5"] | Float[np.ndarray, "pixels 5"]
    size: tuple[int, int]
    milliseconds: float
    hits: int
    dropped: int


class _Program(NamedTuple):
    """A compiled program with its list capacity and the part of the picture that it traces; with
    several devices, `place` is where each pixel lies in their joint output."""

    call: Callable[..., Any]
    capacity: Capacity
    part: Part
    place: np.ndarray | None = None


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
    """Sketches of one scene: on a CPU each core makes its share, elsewhere one device does.

    Camera numbers are inputs of the programs, so moving, focusing or changing the aperture compiles
    nothing. Of a segmented scene, all rays see the segment at the frame's time.
    """

    def __init__(
        self, scene: Scene | Clip, *, options: RenderOptions, trace: TraceOptions, keys: int
    ):
        self._edges, self.trace, self.keys = edges_of(scene), trace, keys
        self._like = dataclasses.replace(options, chunk_rows=0, error=0.0)
        self.scenes = segments_of(scene)
        self._mesh = device_mesh(None if jax.default_backend() == "cpu" else 1)
        self._flat = [jax.tree.flatten(jax.tree.map(jax.numpy.asarray, s)) for s in self.scenes]
        alone = self._mesh.size == 1
        self._shared = [] if alone else [self._everywhere(leaves) for leaves, _ in self._flat]
        self._programs: dict[_Key, _Program] = {}
        self._queued: set[_Key] = set()
        self._lock = threading.Condition()
        self._builder = ThreadPoolExecutor(1, thread_name_prefix="compile")
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
        values, report = self._run(program, key, row, program.part)
        spent = 1000 * (clock.monotonic() - begin)
        if report.dropped.any():
            self._queue(key, camera, _longer(program, report))
        hits, dropped = int(report.hits.sum()), int(report.dropped.sum())
        return Preview(values, key.size, spent, hits, dropped)

    def probe(self, camera: Camera, pixel: tuple[int, int]) -> tuple[float, float]:
        """Alpha and distance along the chief ray of a pixel (column, row).

        Traces one ray. Its program is compiled at the first call.
        """
        row, key = self._key(camera, 1, probe=True)
        self._await(key)
        if key not in self._programs:
            self._build(key, camera)
        at = np.array([pixel[1] * key.size[0] + pixel[0]])
        part, _ = part_of(camera.film, at, self.trace)
        while True:
            program = self._programs[key]
            values, report = self._run(program, key, row, part)
            if not report.dropped:
                own = np.asarray(values)[0]
                return float(own[3]), float(own[4])
            self._build(key, camera, _longer(program, report))

    def has(self, camera: Camera, samples: int) -> bool:
        """Whether the program for such a preview is compiled."""
        return self._key(camera, samples)[1] in self._programs

    def prepare(self, camera: Camera, samples: int, probe: bool = False) -> None:
        """Compile the program for such previews (or for `probe`) in the background, if missing."""
        key = self._key(camera, samples, probe)[1]
        if key not in self._programs:
            self._queue(key, camera)

    def close(self) -> None:
        """Stop compiling."""
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

    def _run(self, program: _Program, key: _Key, row: np.ndarray, part: Part):
        if program.place is None:
            return jax.block_until_ready(program.call(self._flat[key.segment][0], row, part))
        values, report = jax.device_get(program.call(self._shared[key.segment], row, part))
        return values.reshape(-1, 5)[program.place], report

    def _everywhere(self, tree):
        """Copy to all devices that render."""
        return jax.device_put(tree, NamedSharding(self._mesh, PartitionSpec()))

    def _known(self, key: _Key, levels: int) -> Capacity | None:
        """List capacity scaled from a program for a not much smaller picture; None without such a
        program. Measuring it would need another compilation."""
        for other, program in self._programs.items():
            ratio, whole = math.prod(key.size) / math.prod(other.size), program.capacity
            same = other.segment == key.segment and len(whole.cells) == levels + 1
            if same and not key.probe and not other.probe and ratio <= _NEAR:
                ratio = max(ratio, 1)
                cells = tuple(math.ceil(ratio * count) for count in whole.cells)
                return Capacity(cells, math.ceil(ratio * whole.pairs), whole.slots, whole.transient)
        return None

    def _await(self, key: _Key) -> None:
        """Wait for a program that is being compiled."""
        with self._lock:
            self._lock.wait_for(lambda: key not in self._queued)

    def _queue(self, key: _Key, camera: Camera, capacity: Capacity | None = None) -> None:
        with self._lock:
            if key in self._queued or self._builder._shutdown:
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
        part, trace, place = self._part(key, camera)
        options = dataclasses.replace(self._like, samples=key.samples)
        capacity = capacity or self._known(key, trace.levels)
        if capacity is None:
            unknown = ProgramSettings(Capacity((), 0, 0), key.keys, options, trace, None)
            one = part if place is None else jax.tree.map(lambda x: x[0], jax.device_get(part))
            motion, rays = prepare_trace(self.scenes[key.segment], camera, one, settings=unknown)
            capacity = measure(motion, rays, options=trace, headroom=_HEADROOM)
        make, mesh = (render_part, None) if place is None else (render_pieces, self._mesh)
        settings = ProgramSettings(capacity, key.keys, options, trace, mesh)
        call = make(self._flat[key.segment][1], key.layout, settings)
        program = _Program(call, capacity, part, place)
        self._run(program, key, pack_camera(jax.device_get(camera))[0], part)
        self._programs[key] = program

    def _part(self, key: _Key, camera: Camera) -> tuple[Part, TraceOptions, np.ndarray | None]:
        """The part of the picture that a program traces, its trace options, and the places of the
        pixels where several devices share them."""
        if key.probe:
            middle = key.size[1] // 2 * key.size[0] + key.size[0] // 2
            return *part_of(camera.film, np.array([middle]), self.trace), None
        if self._mesh.size == 1:
            return *whole_picture(camera.film, self.trace), None
        part, trace, place = interleaved(camera.film, self.trace, self._mesh.size)
        shared = jax.device_put(part, NamedSharding(self._mesh, PartitionSpec("rays")))
        return shared, trace, np.asarray(place)


def _longer(program: _Program, report: Report) -> Capacity:
    """List capacity enlarged to what a picture needed."""
    needed = np.asarray(report.needed).reshape(-1, report.needed.shape[-1]).max(axis=0)
    return enlarged_capacity(program.capacity, [int(n) for n in needed], headroom=_HEADROOM)
