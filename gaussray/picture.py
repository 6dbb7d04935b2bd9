"""One picture, compiled: rays, the scene at their times, the trace, the film."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jax.tree_util import PyTreeDef
from jaxtyping import Array, Float, Int

from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.chromatic import Chromatic, achromatic, magnified
from gaussray.camera.rays import Rays
from gaussray.camera.sampling import samples as sample_numbers, shifted_samples
from gaussray.camera.shutter import decisive_pixels
from gaussray.raster import dilated, seen_from_center
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.scene import Scene, at, moving_at
from gaussray.tracer.composite import Pixels
from gaussray.tracer.motion import Motion, still
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.trace import Report, TraceOptions, on_kernel, over
from gaussray.tracer.traverse import Capacity


# Batches of samples whose spread is a standard error.
BATCHES = 4


class RenderOptions(eqx.Module):
    """How a picture is sampled.

    `samples` rays per pixel over film, lens and exposure. `keys` states of the scene across the
    times of one frame, between which each ray moves the Gaussians to its own time; 0 takes three
    for every interval between the capture's instants (they share their ends), and a frame whose
    rays share one time needs and takes only one. `chunk_rows` > 0 is the paper's way instead: one
    state for so many rows (1 = a state for every row).

    With an `error` above 0, batches of `samples` are added until the standard error of the mean of
    95 % of the pixels (linear light, the worst of three channels) is at most that, or until the
    next batch would take more than `samples_most` rays per pixel.

    `dilation` (square pixels) and `harmonics` (along each ray, or from the camera's center to a
    Gaussian's) show a model as the rasteriser that it was fitted through: 3DGS has 0.3 and center.
    """

    samples: int = eqx.field(static=True, default=4)
    keys: int = eqx.field(static=True, default=0)
    chunk_rows: int = eqx.field(static=True, default=0)
    dilation: float = eqx.field(static=True, default=0.0)
    harmonics: str = eqx.field(static=True, default="ray")
    error: float = eqx.field(static=True, default=0.0)
    samples_most: int = eqx.field(static=True, default=1024)

    def __check_init__(self):
        if self.samples < 1:
            raise ValueError(f"render.samples must be at least 1, got {self.samples}.")
        if self.keys not in (0, 2) and (self.keys < 3 or self.keys % 2 == 0):
            raise ValueError(
                f"render.keys must be 0 (as many as it takes), 2 or odd from 3, got {self.keys}."
            )
        if self.chunk_rows < 0:
            raise ValueError(f"render.chunk_rows must be at least 0, got {self.chunk_rows}.")
        if not 0 <= self.dilation < math.inf:
            raise ValueError(f"render.dilation must be at least 0, got {self.dilation}.")
        if self.harmonics not in ("ray", "center"):
            raise ValueError(f"render.harmonics must be ray or center, got {self.harmonics!r}.")
        if not 0 <= self.error < math.inf:
            raise ValueError(f"render.error must be at least 0, got {self.error}. 0 is off.")
        least = BATCHES * self.samples
        if self.error and self.samples_most < least:
            raise ValueError(
                f"render.samples_most must be at least {least}, which is {BATCHES} batches of "
                f"render.samples, got {self.samples_most}."
            )


class Part(eqx.Module):
    """What is traced at once: `pixel` index (column, row) in the order of the bundles (padding
    repeats a pixel), and the `slot` of each pixel in it. `row` is where a chunk of rows has its
    time. `batch` is the number of a batch of samples, None if there is only one."""

    pixel: Float[Array, "slots 2"]
    slot: Int[Array, " pixels"]
    row: Float[Array, ""]
    batch: Int[Array, ""] | None = None


class Pace(eqx.Module):
    """What a part is compiled for: list sizes, and how many key states (0: that of its row)."""

    capacity: Capacity
    keys: int = eqx.field(static=True)
    options: RenderOptions
    trace: TraceOptions
    mesh: Mesh | None = eqx.field(static=True)


class Layout(NamedTuple):
    """How a camera's numbers lie in a row, which costs a frame one transfer instead of a dozen."""

    structure: PyTreeDef
    shapes: tuple[tuple[int, ...], ...]
    dtypes: tuple[np.dtype, ...]

    def camera(self, row: Float[Array, " numbers"]) -> Camera:
        """The camera of a row."""
        ends = np.cumsum([math.prod(shape) for shape in self.shapes])
        parts = jnp.split(row, ends[:-1])
        told = zip(parts, self.shapes, self.dtypes, strict=True)
        return jax.tree.unflatten(self.structure, [x.reshape(s).astype(d) for x, s, d in told])


def packed(camera: Camera) -> tuple[Float[np.ndarray, " numbers"], Layout]:
    """A camera whose numbers are on the host as one row."""
    leaves, structure = jax.tree.flatten(camera)
    layout = Layout(structure, tuple(x.shape for x in leaves), tuple(x.dtype for x in leaves))
    return np.concatenate([x.ravel() for x in leaves]), layout


# Samples of a pixel that are traced at once and share what their bundle may meet. That saves a GPU
# most of the search; on a CPU the longer lists cost more (16 samples of a lens take 1.9 times as
# long).
_TOGETHER = 16


@functools.lru_cache(maxsize=64)
def render_part(
    structure: PyTreeDef, layout: Layout, pace: Pace
) -> Callable[..., tuple[Array, Report]]:
    """A compiled function of (leaves of a scene of this structure, row of a camera, part): red,
    green, blue, coverage and mean distance of the part's pixels, the rays spread over the devices.

    Made once for each pace, so that a frame costs the host as little as can be.
    """

    @jax.jit
    def run(leaves: list[Array], row: Array, part: Part):
        return _seen(jax.tree.unflatten(structure, leaves), layout.camera(row), part, pace)

    return run


@functools.lru_cache(maxsize=64)
def render_frames(
    structure: PyTreeDef, layout: Layout, pace: Pace
) -> Callable[..., tuple[Array, Report]]:
    """The same for as many cameras (a row each) as there are devices, a frame on each."""
    if pace.mesh is None:
        raise ValueError("frames are spread over a mesh of devices, got none.")
    everywhere, split = PartitionSpec(), PartitionSpec("rays")
    placed = [NamedSharding(pace.mesh, spec) for spec in (everywhere, split, everywhere)]
    alone = Pace(pace.capacity, pace.keys, pace.options, pace.trace, None)

    def one_device(leaves, rows, part):
        scene = jax.tree.unflatten(structure, leaves)
        seen = _seen(scene, layout.camera(rows[0]), part, alone)
        return jax.tree.map(lambda x: x[None], seen)

    return jax.jit(
        jax.shard_map(
            one_device,
            mesh=pace.mesh,
            in_specs=(everywhere, split, everywhere),
            out_specs=split,
            check_vma=False,
        ),
        in_shardings=tuple(placed),
    )


def _seen(scene: Scene, camera: Camera, part: Part, pace: Pace) -> tuple[Array, Report]:
    motion = _motion(scene, camera, part, pace)
    if isinstance(camera.lens, Chromatic):

        def channel(magnification: Float[Array, ""]) -> tuple[Pixels, Report]:
            return _traced(motion, magnified(camera, magnification), part, pace)

        seen, reports = over(channel, camera.lens.magnification)
        color = jnp.stack([seen.color[i, :, i] for i in range(3)], axis=-1)
        pixels = Pixels(color, jnp.mean(seen.transmittance, axis=0), jnp.mean(seen.depth, axis=0))
        report = _all_of(reports)
    else:
        pixels, report = _traced(motion, camera, part, pace)
    alpha = 1 - pixels.transmittance
    depth = pixels.depth / jnp.maximum(alpha, 1e-6)
    return jnp.concatenate([pixels.color, alpha[:, None], depth[:, None]], axis=1), report


def _traced(motion: Motion, camera: Camera, part: Part, pace: Pace) -> tuple[Pixels, Report]:
    """The part's pixels, each the mean of its samples."""
    count = pace.options.samples
    u = sample_numbers(count) if part.batch is None else shifted_samples(count, part.batch)
    u = u.astype(part.pixel.dtype)

    def trace_some(u: Float[Array, "samples 5"]) -> tuple[tuple[Pixels, Array | None], Report]:
        rays = _rays(camera, part.pixel, u)
        pixels, report = trace_sharded(
            motion, rays, options=pace.trace, capacity=pace.capacity, mesh=pace.mesh
        )
        weight = rays.weight
        if weight is not None:
            pixels = jax.tree.map(lambda x: x * _like(weight, x), pixels)
        return jax.tree.map(lambda x: jnp.mean(x, axis=0), (pixels, weight)), report

    seen, reports = over(trace_some, u.reshape(-1, _together(pace), 5))
    pixels, weight = jax.tree.map(lambda x: jnp.mean(x, axis=0)[part.slot], seen)
    return pixels if weight is None else _vignetted(pixels, weight), _all_of(reports)


def _vignetted(pixels: Pixels, weight: Array) -> Pixels:
    """Means of weight times value: light that is lost stays dark, and what else is told becomes the
    mean over the light that is not."""
    some = weight > 0
    whole = jnp.where(some, weight, 1)
    told = jax.tree.map(lambda x: x / _like(whole, x), pixels)
    clear = jnp.where(some, told.transmittance, 1)
    return dataclasses.replace(told, color=pixels.color, transmittance=clear)


def _like(weight: Array, value: Array) -> Array:
    """Weights of rays beside what those see, which may have channels."""
    return weight.reshape(weight.shape + (1,) * (value.ndim - weight.ndim))


def _all_of(reports: Report) -> Report:
    return Report(
        needed=jnp.max(reports.needed, axis=0),
        dropped=jnp.sum(reports.dropped),
        skipped=jnp.max(reports.skipped),
        hits=jnp.sum(reports.hits),
    )


def _rays(camera: Camera, pixel: Array, u: Float[Array, "samples 5"]) -> Rays:
    def sample(one: Float[Array, "5"]) -> Rays:
        return camera_rays(camera, pixel, jnp.broadcast_to(one, (pixel.shape[0], 5)))

    return jax.vmap(sample)(u)


def _motion(scene: Scene, camera: Camera, part: Part, pace: Pace) -> Motion:
    camera = achromatic(camera)
    key_time, options = _key_times(camera, part, pace.keys), pace.options

    def shown(gaussians: Gaussians) -> Gaussians:
        if options.dilation:
            gaussians = dilated(gaussians, camera, options.dilation)
        if options.harmonics == "center":
            mean = gaussians.mean
            mean = mean if mean.ndim == 2 else mean[mean.shape[0] // 2]
            gaussians = seen_from_center(gaussians, camera, mean)
        return gaussians

    if key_time.shape[0] == 1 or scene.deformation is None:
        return still(shown(at(scene, key_time[0])))
    rest = shown(scene.static) if scene.static.count else None
    return Motion(key_time, shown(moving_at(scene, key_time)), rest)


def _key_times(camera: Camera, part: Part, keys: int) -> Float[Array, " keys"]:
    dtype = camera.time.dtype
    if not keys:
        place = jnp.stack([jnp.zeros_like(part.row), part.row])
        return camera_rays(camera, place[None], jnp.full((1, 5), 0.5, dtype)).time
    pixel = decisive_pixels(camera.shutter, (camera.film.width, camera.film.height))
    place = jnp.asarray(np.repeat(pixel, 2, axis=0), dtype)
    u = np.full((len(place), 5), 0.5)
    u[:, 4] = np.tile([0, 1], len(pixel))
    time = camera_rays(camera, place, jnp.asarray(u, dtype)).time
    first, last = jnp.min(time), jnp.max(time)
    return jnp.linspace(first, last, keys, dtype=dtype) if keys > 1 else first[None]


@eqx.filter_jit
def about_to_trace(scene: Scene, camera: Camera, part: Part, *, pace: Pace) -> tuple[Motion, Rays]:
    """What is traced at once, to measure list sizes with."""
    u = sample_numbers(pace.options.samples).astype(part.pixel.dtype)
    motion = _motion(scene, camera, part, pace)
    return motion, _rays(camera, part.pixel, u[: _together(pace)])


def _together(pace: Pace) -> int:
    kernel = on_kernel(pace.trace, jnp.float32)
    return math.gcd(pace.options.samples, _TOGETHER) if kernel else 1
