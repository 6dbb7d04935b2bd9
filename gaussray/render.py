"""Stage 2: a scene and a camera in, pictures out."""

import threading
import time as clock
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.shutter import time_window
from gaussray.picture import (
    BATCHES,
    Layout,
    Pace,
    Part,
    RenderOptions as RenderOptions,
    about_to_trace,
    packed,
    render_frames,
    render_part,
)
from gaussray.scene.scene import Scene, key_count
from gaussray.tracer.bundle import tiles
from gaussray.tracer.shard import mesh as device_mesh
from gaussray.tracer.trace import TraceOptions, enlarge, measure
from gaussray.tracer.traverse import Capacity


# Batches of frames that are begun before the first of them has been fetched, and their bytes.
_IN_FLIGHT, _BYTES = 8, 2 * 1024**3


# Share of the pixels whose standard error is to be reached.
SHARE = 0.95


class Frame(eqx.Module):
    """A finished picture: linear light, coverage (1 - transmittance) and mean distance t of what is
    seen, with what it cost: `samples` rays per pixel. With `render.error`, `error` is the standard
    error of each pixel's colour, the worst of three channels."""

    color: Float[np.ndarray, "h w 3"]
    alpha: Float[np.ndarray, "h w"]
    depth: Float[np.ndarray, "h w"]
    seconds: float
    hits: int
    compiled: bool
    samples: int = 0
    error: Float[np.ndarray, "h w"] | None = None


class Renderer:
    """Renders frame after frame of one scene; list sizes are measured once and kept.

    An overflow is caught, the sizes are raised, and the frame is rendered again: nothing is lost.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        options: RenderOptions | None = None,
        trace: TraceOptions | None = None,
        devices: int | None = None,
    ):
        self.scene = scene
        self.options = options or RenderOptions()
        self.trace = trace or TraceOptions()
        self.mesh = device_mesh(devices)
        leaves, self._structure = jax.tree.flatten(scene)
        self._leaves = self._everywhere(leaves)
        self._capacity: dict[tuple, Capacity] = {}
        self._parts: dict[tuple, tuple[Part, TraceOptions]] = {}
        self._ready: set = set()
        self._repairing = threading.Lock()
        # Key states by span: a frame shall not ask the device for the instants of the capture.
        self._counts: dict[float, int] = {}

    def __call__(self, camera: Camera) -> Frame:
        """One frame, its rays spread over the devices."""
        if self.options.error:
            return self._settled(camera)
        return self._finish(self._begin(list(self._views([camera])), alone=True))[0]

    def film(self, cameras: Iterable[Camera]) -> Iterator[Frame]:
        """Frame after frame, one on each device, begun before the last ones are finished. A frame's
        `seconds` are those since it was begun.

        Threads fetch the pictures: pages of memory for a picture take the host longer than a GPU
        takes to make it. With `render.error` one frame is finished before the next is begun.
        """
        if self.options.error:
            yield from map(self, cameras)
            return
        waiting: deque[Future[list[Frame]]] = deque()
        with ThreadPoolExecutor(_IN_FLIGHT) as pool:
            for views in self._batches(self._views(cameras)):
                batch = self._begin(views, alone=self.mesh.size == 1)
                waiting.append(pool.submit(self._finish, batch))
                # After a compilation lists may turn out too short: better for one frame than eight.
                while waiting and (len(waiting) > batch.in_flight or batch.compiled):
                    yield from waiting.popleft().result()
            for following in waiting:
                yield from following.result()

    def _settled(self, camera: Camera) -> Frame:
        """A frame of as many batches of samples as `render.error` takes: running means, and sums of
        squares about them (Welford 1962)."""
        options, views = self.options, list(self._views([camera]))
        most = options.samples_most // options.samples
        mean = spread = error = np.zeros(())
        seconds, hits, compiled = 0.0, 0, False
        for count in range(1, most + 1):
            frame = self._finish(self._begin(views, alone=True, number=count - 1))[0]
            seconds, hits = seconds + frame.seconds, hits + frame.hits
            compiled |= frame.compiled
            depth = frame.depth * frame.alpha
            told = np.dstack([frame.color, frame.alpha, depth]).astype(np.float64)
            away = told - mean
            mean = mean + away / count
            spread = spread + (away * (told - mean))[..., :3]
            if count >= BATCHES:
                error = np.sqrt(spread.max(axis=-1) / (count * (count - 1)))
                if np.quantile(error, SHARE) <= options.error:
                    break
        told = np.dstack([mean[..., :4], mean[..., 4] / np.maximum(mean[..., 3], 1e-6)])
        color, alpha, depth = _split(told.astype(np.float32))
        error, used = error.astype(np.float32), count * options.samples
        return Frame(color, alpha, depth, seconds, hits, compiled, used, error)

    def _views(self, cameras: Iterable[Camera]) -> Iterator["_View"]:
        """Cameras on the host, whose business small numbers are: a device is asked for many of them
        at once."""
        cameras = iter(cameras)
        while some := list(islice(cameras, 64)):
            for camera in jax.device_get(some):
                yield _View(camera, *packed(camera), self._keys(camera))

    def _batches(self, views: Iterable["_View"]) -> Iterator[list["_View"]]:
        """Neighbours that can be compiled as one, as many as there are devices."""
        batch: list[_View] = []
        for view in views:
            if batch and (len(batch) == self.mesh.size or not batch[0].is_like(view)):
                yield batch
                batch = []
            batch.append(view)
        if batch:
            yield batch

    def _keys(self, camera: Camera) -> int:
        """Key states for a frame; 0 where chunks of rows are called for."""
        span = _time_span(camera)
        if span == 0:
            return 1
        if not self.options.chunk_rows:
            if span not in self._counts:
                self._counts[span] = self.options.keys or key_count(self.scene, span)
            return self._counts[span]
        if camera.shutter.direction in ("left_to_right", "right_to_left"):
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

    def _begin(self, views: list["_View"], *, alone: bool, number: int | None = None) -> "_Batch":
        """Frames that are being rendered, in one part or in chunks of rows."""
        film = views[0].camera.film
        rows = film.height if views[0].keys else min(self.options.chunk_rows, film.height)
        batch = _Batch(views, alone, rows, number)
        for top in (min(y, film.height - rows) for y in range(0, film.height, rows)):
            if batch.parts and jax.default_backend() == "cpu":
                # Parts under way together share the cores' threads, where the sums over devices of
                # one can wait for those of another without end.
                jax.block_until_ready(batch.parts[-1][1])
            batch.parts.append((top, *self._launch(batch, top)))
        return batch

    def _launch(self, batch: "_Batch", top: int):
        """Values and report of a part, under way."""
        size = batch.size
        part, trace = self._part(top, batch)
        if size not in self._capacity:
            self._capacity[size] = self._measure(batch, part, trace)
        if batch.number is not None:
            part = replace(part, batch=jnp.asarray(batch.number, jnp.int32))
        pace = Pace(self._capacity[size], batch.keys, self.options, trace, self.mesh)
        batch.compiled |= (size, pace.capacity) not in self._ready
        self._ready.add((size, pace.capacity))
        rows, layout = [view.row for view in batch.views], batch.views[0].layout
        if batch.alone:
            return render_part(self._structure, layout, pace)(self._leaves, rows[0], part)
        # A device without a frame of its own repeats the last.
        rows = np.stack(rows + rows[-1:] * (self.mesh.size - len(rows)))
        return render_frames(self._structure, layout, pace)(self._leaves, rows, part)

    def _finish(self, batch: "_Batch") -> list[Frame]:
        """The frames of a batch; parts whose lists were too short are rendered again."""
        film, hits, count = batch.film, 0, len(batch.views)
        pieces = []
        for top, values, report in batch.parts:
            while np.any(report.dropped):
                needed = np.asarray(report.needed).reshape(-1, report.needed.shape[-1])
                wanted = [int(n) for n in needed.max(axis=0)]
                with self._repairing:
                    held = self._capacity[batch.size]
                    self._capacity[batch.size] = enlarge(held, wanted, headroom=1.5)
                    values, report = self._launch(batch, top)
            seen = [x.reshape(batch.rows, film.width, 5) for x in _pictures(values, count)]
            pieces.append((top, seen))
            hits += int(np.sum(report.hits))
        seconds = (clock.monotonic() - batch.began) / count
        return [
            Frame(*_split(x), seconds, hits // count, batch.compiled, self.options.samples)
            for x in (_joined(film, [(top, seen[i]) for top, seen in pieces]) for i in range(count))
        ]

    def _part(self, top: int, batch: "_Batch") -> tuple[Part, TraceOptions]:
        film, trace = batch.film, self.trace
        key = film.width, film.height, top, batch.rows, batch.keys == 0
        if key not in self._parts:
            if batch.keys:
                order = tiles(film.width, film.height, trace.bundle, trace.levels)
            else:
                y, x = np.mgrid[top : top + batch.rows, : film.width]
                order = (y * film.width + x).T.reshape(-1)
            if len(order) < trace.bundle**2 * 256:
                trace = replace(trace, levels=0)
            inside = np.flatnonzero(order >= 0)
            slot = inside[np.argsort(order[inside])].astype(np.int32)
            middle = jnp.asarray(top + (batch.rows - 1) / 2, jnp.float32)
            part = Part(_pixels(order, film.width), jnp.asarray(slot), middle)
            self._parts[key] = self._everywhere(part), trace
        return self._parts[key]

    def _everywhere(self, tree):
        """On every device, once for all frames."""
        if self.mesh.size == 1:
            return tree
        return jax.device_put(tree, NamedSharding(self.mesh, PartitionSpec()))

    def _measure(self, batch: "_Batch", part: Part, trace: TraceOptions) -> Capacity:
        unknown = Pace(Capacity((), 0, 0), batch.keys, self.options, trace, None)
        part = jax.device_get(part)
        camera = batch.views[0].camera
        motion, rays = about_to_trace(self.scene, camera, part, pace=unknown)
        found = measure(motion, rays, options=trace, headroom=1.5)
        # A device sees its share of the bundles, but any one device may get the fullest.
        share = self.mesh.size if batch.alone else 1
        return Capacity(
            tuple(max(-(-c * 5 // (4 * share)), 64) for c in found.cells),
            max(-(-found.pairs * 5 // (4 * share)), 64),
            found.slots,
        )


class _View(NamedTuple):
    """A camera, its numbers in a row, and the key states of its frame."""

    camera: Camera
    row: Float[np.ndarray, " numbers"]
    layout: Layout
    keys: int

    def is_like(self, other: "_View") -> bool:
        """Whether one program serves both."""
        return self.layout == other.layout and self.keys == other.keys


class _Batch:
    """Frames under way: one whose rays are spread over the devices (`alone`), or one on each."""

    def __init__(self, views: list[_View], alone: bool, rows: int, number: int | None = None):
        self.number = number
        self.views, self.alone, self.rows = views, alone, rows
        self.film, self.keys = views[0].camera.film, views[0].keys
        self.began, self.compiled = clock.monotonic(), False
        self.parts: list[tuple] = []
        self.size = (self.film.width, rows, self.keys, views[0].layout, alone)

    @property
    def in_flight(self) -> int:
        """Batches like this that may be under way before one is fetched; a CPU fetches nothing."""
        if jax.default_backend() == "cpu":
            return 1
        size = len(self.views) * self.film.width * self.film.height * 5 * 4
        return min(max(_BYTES // size, 1), _IN_FLIGHT)


def _split(values: Float[np.ndarray, "h w 5"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour, coverage and depth of a picture's values."""
    return values[..., :3], values[..., 3], values[..., 4]


def _joined(film: Film, pieces: list[tuple[int, np.ndarray]]) -> Float[np.ndarray, "h w 5"]:
    """A picture from chunks of rows, which may overlap."""
    if len(pieces) == 1:
        return pieces[0][1]
    whole = np.empty((film.height, film.width, 5), np.float32)
    for top, piece in pieces:
        whole[top : top + len(piece)] = piece
    return whole


def _pictures(values: Array, count: int) -> list[np.ndarray]:
    """The frames of a batch, one from each device, as they came: nothing is copied once more."""
    if values.ndim == 2:
        return [np.asarray(values)]
    shards = sorted(values.addressable_shards, key=lambda shard: shard.index[0].start)
    return [np.asarray(shard.data) for shard in shards[:count]]


def _pixels(order: np.ndarray, width: int) -> Float[Array, "slots 2"]:
    """Indices (column, row); padding repeats the first pixel and is in no one's slot."""
    index = np.maximum(order, 0)
    return jnp.asarray(np.stack([index % width, index // width], axis=-1), jnp.float32)


def _time_span(camera: Camera) -> float:
    """How long the camera looks, from the first ray's time to the last one's."""
    film = camera.film
    earliest, latest = time_window(jax.device_get(camera.shutter), (film.width, film.height))
    return latest - earliest
