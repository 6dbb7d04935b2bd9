"""Stage 2: a scene and a camera in, pictures out."""

import math
import time as clock
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int

from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.rays import Rays
from gaussray.camera.sampling import samples as sample_numbers
from gaussray.scene.scene import Scene, at, at_times
from gaussray.tracer.bundle import tiles
from gaussray.tracer.composite import Pixels
from gaussray.tracer.motion import Motion, still
from gaussray.tracer.shard import mesh as device_mesh, trace_sharded
from gaussray.tracer.trace import Report, TraceOptions, enlarge, measure
from gaussray.tracer.traverse import Capacity


class RenderOptions(eqx.Module):
    """How a picture is sampled.

    `samples` rays per pixel over film, lens and exposure. `keys` states of the scene across the
    times of one frame, between which each ray moves the Gaussians to its own time; 0 takes three
    for every interval between the capture's instants (they share their ends), and a frame whose
    rays share one time needs and takes only one. `chunk_rows` > 0 is the paper's way instead: one
    state for so many rows (1 = a state for every row).
    """

    samples: int = eqx.field(static=True, default=4)
    keys: int = eqx.field(static=True, default=0)
    chunk_rows: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        if self.samples < 1:
            raise ValueError(f"render.samples must be at least 1, got {self.samples}.")
        if self.keys not in (0, 2) and (self.keys < 3 or self.keys % 2 == 0):
            raise ValueError(
                f"render.keys must be 0 (as many as it takes), 2 or odd from 3, got {self.keys}."
            )
        if self.chunk_rows < 0:
            raise ValueError(f"render.chunk_rows must be at least 0, got {self.chunk_rows}.")


class Frame(eqx.Module):
    """A finished picture: linear light, coverage (1 - transmittance) and mean distance t of what is
    seen, with what it cost."""

    color: Float[np.ndarray, "h w 3"]
    alpha: Float[np.ndarray, "h w"]
    depth: Float[np.ndarray, "h w"]
    seconds: float
    hits: int
    compiled: bool


@eqx.filter_jit
def render_chunk(
    scene: Scene,
    camera: Camera,
    pixel: Float[Array, "rays 2"],
    key_time: Float[Array, " keys"],
    *,
    options: RenderOptions,
    trace: TraceOptions,
    capacity: Capacity,
    mesh: Mesh,
) -> tuple[Pixels, Report]:
    """The mean over a pixel's samples: rays, the scene at their times, the trace. One sample after
    the other, so that memory does not grow with their number."""
    motion = _motion(scene, key_time)
    u = sample_numbers(options.samples).astype(pixel.dtype)

    def sample(u: Float[Array, "5"]) -> tuple[Pixels, Report]:
        rays = camera_rays(camera, pixel, jnp.broadcast_to(u, (pixel.shape[0], 5)))
        return trace_sharded(motion, rays, options=trace, capacity=capacity, mesh=mesh)

    pixels, reports = jax.lax.map(sample, u)
    mean = jax.tree.map(lambda x: jnp.mean(x, axis=0), pixels)
    return mean, Report(
        needed=jnp.max(reports.needed, axis=0),
        dropped=jnp.sum(reports.dropped),
        skipped=jnp.max(reports.skipped),
        hits=jnp.sum(reports.hits),
    )


def _motion(scene: Scene, key_time: Float[Array, " keys"]) -> Motion:
    if key_time.shape[0] == 1:
        return still(at(scene, key_time[0]))
    return Motion(key_time, at_times(scene, key_time))


@eqx.filter_jit
def _chief_rays(scene: Scene, camera: Camera, pixel: Array, key_time: Array) -> tuple[Motion, Rays]:
    """What one sample of every pixel is about to trace."""
    u = jnp.full((pixel.shape[0], 5), 0.5, pixel.dtype)
    return _motion(scene, key_time), camera_rays(camera, pixel, u)


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
        self._capacity: dict[tuple, Capacity] = {}
        self._ready: set = set()

    def __call__(self, camera: Camera) -> Frame:
        """One frame."""
        began = clock.monotonic()
        film = camera.film
        first, last = _moving_times(camera)
        if self.options.chunk_rows and first < last:
            if camera.shutter.direction in ("left_to_right", "right_to_left"):
                raise ValueError(
                    "render.chunk_rows must be 0 for a shutter that reads columns, as "
                    f"{camera.shutter.direction} does: key states suit any direction."
                )
            parts = [self._rows(camera, top) for top in self._tops(film.height)]
        else:
            order = tiles(film.width, film.height, self.trace.bundle, self.trace.levels)
            keys = 1 if first == last else self.options.keys or key_count(self.scene, last - first)
            parts = [self._part(camera, order, jnp.linspace(first, last, keys, dtype=jnp.float32))]
        flat = np.zeros((film.height * film.width, 5), np.float32)
        for order, pixels, _ in parts:
            inside = order >= 0
            values = np.concatenate(
                [pixels.color, pixels.transmittance[:, None], pixels.depth[:, None]], axis=1
            )
            flat[order[inside]] = values[inside]
        flat = flat.reshape(film.height, film.width, 5)
        alpha = 1 - flat[..., 3]
        hits, fresh = sum(int(p[2][0]) for p in parts), any(p[2][1] for p in parts)
        depth = flat[..., 4] / np.maximum(alpha, 1e-6)
        seconds = clock.monotonic() - began
        return Frame(flat[..., :3], alpha, depth, seconds, hits, fresh)

    def _tops(self, height: int) -> Sequence[int]:
        rows = min(self.options.chunk_rows, height)
        return [min(top, height - rows) for top in range(0, height, rows)]

    def _rows(self, camera: Camera, top: int):
        """A chunk of rows at the mean time of its rows."""
        film, rows = camera.film, min(self.options.chunk_rows, camera.film.height)
        y, x = np.mgrid[top : top + rows, : film.width]
        order = (y * film.width + x).T.reshape(-1)
        middle = np.array([0.0, top + (rows - 1) / 2], np.float32)
        center = jnp.full((1, 5), 0.5, jnp.float32)
        time = camera_rays(camera, jnp.asarray(middle)[None], center).time
        return self._part(camera, order, time)

    def _part(self, camera: Camera, order: Int[np.ndarray, " slots"], key_time: Array):
        pixel = _pixels(order, camera.film.width)
        trace = self.trace
        if len(order) < trace.bundle**2 * 256:
            trace = _flat(trace)
        size = (len(order), key_time.shape[0], jax.tree.structure(camera))
        fresh = False
        while True:
            capacity = self._capacity.get(size) or self._measure(camera, pixel, key_time, trace)
            fresh = fresh or (size, capacity) not in self._ready
            pixels, report = render_chunk(
                self.scene,
                camera,
                pixel,
                key_time,
                options=self.options,
                trace=trace,
                capacity=capacity,
                mesh=self.mesh,
            )
            self._capacity[size] = capacity
            self._ready.add((size, capacity))
            if int(report.dropped) == 0:
                host = jax.tree.map(np.asarray, pixels)
                return order, host, (int(report.hits), fresh)
            needed = [int(n) for n in report.needed]
            self._capacity[size] = enlarge(capacity, needed, headroom=1.5)

    def _measure(self, camera: Camera, pixel: Array, key_time: Array, trace: TraceOptions):
        motion, rays = _chief_rays(self.scene, camera, pixel, key_time)
        found = measure(motion, rays, options=trace, headroom=1.5)
        # A device sees its share of the bundles, but any one device may get the fullest.
        share = self.mesh.size
        return Capacity(
            tuple(max(-(-c * 5 // (4 * share)), 64) for c in found.cells),
            max(-(-found.pairs * 5 // (4 * share)), 64),
            found.slots,
        )


def key_count(scene: Scene, span: float) -> int:
    """Key states for a frame that lasts for `span`: three for every interval between the capture's
    instants that it may touch, so that each arc is as short as the motion was sampled."""
    if scene.deformation is None:
        return 1
    instants = np.asarray(scene.deformation.bodies.time)
    if len(instants) < 2:
        return 3
    # Rounding of single precision shall not cost an arc.
    intervals = math.ceil(span / float(np.median(np.diff(instants))) - 1e-3)
    return 2 * min(max(intervals, 1), len(instants) - 1) + 1


def _flat(trace: TraceOptions) -> TraceOptions:
    values = {name: getattr(trace, name) for name in trace.__dataclass_fields__}
    return TraceOptions(**(values | {"levels": 0}))


def _pixels(order: np.ndarray, width: int) -> Float[Array, "slots 2"]:
    """Indices (column, row); padding slots lie far outside and are thrown away."""
    index = np.maximum(order, 0)
    return jnp.asarray(np.stack([index % width, index // width], axis=-1), jnp.float32)


def _moving_times(camera: Camera) -> tuple[float, float]:
    """Earliest and latest time of the camera's rays."""
    first, last = _time_span(camera)
    return float(first), float(last)


@eqx.filter_jit
def _time_span(camera: Camera) -> tuple[Array, Array]:
    film, dtype = camera.film, camera.time.dtype
    corner = [(0, 0), (0, 0), (film.width - 1, film.height - 1), (film.width - 1, film.height - 1)]
    u = jnp.full((4, 5), 0.5, dtype).at[:, 4].set(jnp.asarray([0, 1, 0, 1], dtype))
    time = camera_rays(camera, jnp.asarray(corner, dtype), u).time
    return jnp.min(time), jnp.max(time)
