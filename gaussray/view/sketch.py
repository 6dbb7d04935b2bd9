"""Pictures made at once, by programs that are ready; those that are not are compiled meanwhile."""

import dataclasses
import math
import threading
import time as clock
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import time_window
from gaussray.parts import Layout, Pace, Part, RenderOptions, packed, part_of, whole_picture
from gaussray.picture import about_to_trace, render_part
from gaussray.scene.clip import Clip, edges_of, segments_of
from gaussray.scene.scene import Scene
from gaussray.tracer.trace import Report, TraceOptions, enlarge, measure
from gaussray.tracer.traverse import Capacity


# Room in the lists beyond what the first picture needed: the next ones look elsewhere.
HEADROOM = 2.0
# How many times as many pixels a picture may have for another's lists to be a measure of its own.
NEAR = 5.0


class Sketch(NamedTuple):
    """A picture that is still on the device: red, green, blue, coverage and distance of every
    pixel, with the milliseconds and the hits that it took, and how many candidates were `dropped`
    because lists were too short; they are being lengthened."""

    values: Float[Array, "pixels 5"]
    size: tuple[int, int]
    milliseconds: float
    hits: int
    dropped: int


class _Program(NamedTuple):
    call: Callable[..., Any]
    capacity: Capacity
    part: Part


class _Key(NamedTuple):
    """What a program is compiled for: the camera's kind, the picture's size, key states, rays a
    pixel, a segment, and whether it is for a single pixel."""

    layout: Layout
    size: tuple[int, int]
    keys: int
    samples: int
    segment: int
    probe: bool


class Sketcher:
    """Sketches of one scene, on one device.

    A camera's numbers are inputs of its program: moving, focusing, opening never compile anything.
    Of a clip, the segment that shows the frame's time is seen by all rays.
    """

    def __init__(
        self, scene: Scene | Clip, *, options: RenderOptions, trace: TraceOptions, keys: int
    ):
        self._edges, self.trace, self.keys = edges_of(scene), trace, keys
        self._like = dataclasses.replace(options, chunk_rows=0, error=0.0)
        self.scenes = segments_of(scene)
        self._flat = [jax.tree.flatten(jax.tree.map(jax.numpy.asarray, s)) for s in self.scenes]
        self._programs: dict[_Key, _Program] = {}
        self._ordered: set[_Key] = set()
        self._lock = threading.Condition()
        self._builder = ThreadPoolExecutor(1, thread_name_prefix="compile")
        self.failure: Exception | None = None

    @property
    def building(self) -> int:
        """How many programs are being compiled or wait for it."""
        return len(self._ordered)

    def __call__(self, camera: Camera, samples: int) -> Sketch | None:
        """The picture, or None while its program is being compiled."""
        row, key = self._key(camera, samples)
        program = self._programs.get(key)
        if program is None:
            self._order(key, camera)
            return None
        begin = clock.monotonic()
        values, report = self._run(program, key, row, program.part)
        spent = 1000 * (clock.monotonic() - begin)
        if report.dropped:
            self._order(key, camera, _longer(program, report))
        return Sketch(values, key.size, spent, int(report.hits), int(report.dropped))

    def probe(self, camera: Camera, pixel: tuple[int, int]) -> tuple[float, float]:
        """Coverage, and distance along the chief ray, of what a pixel (column, row) shows.

        One ray is traced. Its program is compiled when the first pixel is asked for.
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
        """Whether a picture would come at once."""
        return self._key(camera, samples)[1] in self._programs

    def prepare(self, camera: Camera, samples: int, probe: bool = False) -> None:
        """Compile what is missing for such pictures (or for a `probe` in them), meanwhile."""
        key = self._key(camera, samples, probe)[1]
        if key not in self._programs:
            self._order(key, camera)

    def close(self) -> None:
        """Compile nothing more."""
        self._builder.shutdown(wait=False, cancel_futures=True)

    def _key(self, camera: Camera, samples: int, probe: bool = False):
        camera = jax.device_get(camera)
        row, layout = packed(camera)
        film = camera.film
        begin, end = time_window(camera.shutter, (film.width, film.height))
        segment = int(np.searchsorted(self._edges, float(camera.time), side="right"))
        moves = end > begin and self.scenes[segment].deformation is not None
        keys = self.keys if moves else 1
        return row, _Key(layout, (film.width, film.height), keys, samples, segment, probe)

    def _run(self, program: _Program, key: _Key, row: np.ndarray, part: Part):
        return jax.block_until_ready(program.call(self._flat[key.segment][0], row, part))

    def _known(self, key: _Key, levels: int) -> Capacity | None:
        """Lists for a picture from those of one not much smaller: as long for every bundle, of
        which there are more. Measuring would have to be compiled, too."""
        for other, program in self._programs.items():
            ratio, whole = math.prod(key.size) / math.prod(other.size), program.capacity
            same = other.segment == key.segment and len(whole.cells) == levels + 1
            if same and not key.probe and not other.probe and ratio <= NEAR:
                ratio = max(ratio, 1)
                cells = tuple(math.ceil(ratio * count) for count in whole.cells)
                return Capacity(cells, math.ceil(ratio * whole.pairs), whole.slots)
        return None

    def _await(self, key: _Key) -> None:
        """Until a program that is being compiled is there."""
        with self._lock:
            self._lock.wait_for(lambda: key not in self._ordered)

    def _order(self, key: _Key, camera: Camera, capacity: Capacity | None = None) -> None:
        with self._lock:
            if key in self._ordered or self._builder._shutdown:
                return
            self._ordered.add(key)
        self._builder.submit(self._made, key, camera, capacity)

    def _made(self, key: _Key, camera: Camera, capacity: Capacity | None) -> None:
        try:
            self._build(key, camera, capacity)
        except Exception as error:
            self.failure = error
        finally:
            with self._lock:
                self._ordered.discard(key)
                self._lock.notify_all()

    def _build(self, key: _Key, camera: Camera, capacity: Capacity | None = None) -> None:
        """The program of a key, for lists as this camera needs them or as they are told."""
        options = dataclasses.replace(self._like, samples=key.samples)
        if key.probe:
            middle = key.size[1] // 2 * key.size[0] + key.size[0] // 2
            part, trace = part_of(camera.film, np.array([middle]), self.trace)
        else:
            part, trace = whole_picture(camera.film, self.trace)
        capacity = capacity or self._known(key, trace.levels)
        if capacity is None:
            unknown = Pace(Capacity((), 0, 0), key.keys, options, trace, None)
            motion, rays = about_to_trace(self.scenes[key.segment], camera, part, pace=unknown)
            capacity = measure(motion, rays, options=trace, headroom=HEADROOM)
        pace = Pace(capacity, key.keys, options, trace, None)
        leaves, structure = self._flat[key.segment]
        row, _ = packed(jax.device_get(camera))
        run = render_part(structure, key.layout, pace)
        jax.block_until_ready(run(leaves, row, part))
        self._programs[key] = _Program(run, capacity, part)


def _longer(program: _Program, report: Report) -> Capacity:
    """Lists with room for what a picture needed."""
    needed = [int(n) for n in report.needed]
    return enlarge(program.capacity, needed, headroom=HEADROOM)
