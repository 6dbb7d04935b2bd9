"""Parts of a picture: the pixels that are traced at once, in the order of ray bundles."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.camera.film import Film
from gaussray.io.plain_values import to_device
from gaussray.render.options import RenderOptions
from gaussray.render.segments import SegmentRays
from gaussray.tracer.bundle import FAN, fill_padding, morton_tiles
from gaussray.tracer.grid import OCCUPANCY
from gaussray.tracer.options import CPU_LEVELS, TraceOptions, on_cpu_kernel, on_kernel


# Samples of a pixel that are traced at once and share what their bundle may meet. That saves a GPU
# most of the search; on a CPU the longer lists cost more (16 samples of a lens take 1.9 times as
# long).
_SAMPLES_AT_ONCE = 16
# Cells of the grid times bundles of the coarsest level, at most, where levels can be added: the
# answers of so many tests are in memory at once. Machine code on a CPU tests the Gaussians, of
# which so many tests take as long as a third level saves (100,000 and 10,000 at 512 x 512).
_TESTS, _CPU_TESTS = 1 << 26, 1 << 23
# Bytes that a frame takes for each ray under way, its share of the lists included (1,000 Gaussians,
# 256 x 256 pixels, XLA's own count on a CPU: 584 in all; a kernel keeps less, by the sizes of its
# arrays), for each group of samples of a pixel, and for each pixel.
RAY, RAY_OF_KERNEL, SAMPLE, PIXEL = 520, 100, 20, 60


class Part(eqx.Module):
    """The pixels that are traced at once. Parts of several devices may be stacked.

    Args:
        pixel: indices (column, row) in the order of the ray bundles; padding repeats a pixel.
        slot: place of each pixel in that order.
        row: row whose time a chunk of rows uses.
        share: the rays of one segment, where several segments of a clip show a frame; None is all.
        batch: number of a batch of samples; None if there is only one.
    """

    pixel: Float[Array, "*devices slots 2"]
    slot: Int[Array, "*devices pixels"]
    row: Float[Array, "*devices"]
    share: SegmentRays | None = None
    batch: Int[Array, "*devices"] | None = None


def whole_picture(film: Film, trace: TraceOptions) -> tuple[Part, TraceOptions]:
    """All pixels of a picture as one part, and its trace options.

    A small picture needs no coarser bundles.

    Args:
        film: size of the picture.
        trace: options of the tracer.
    """
    order = morton_tiles(film.width, film.height, trace.bundle, trace.levels)
    return pixels_part(film, order, trace)


def samples_at_once(options: RenderOptions, trace: TraceOptions) -> int:
    """Number of samples of a pixel that are traced at once.

    Args:
        options: how the picture is sampled.
        trace: options of the tracer.
    """
    return math.gcd(options.samples, _SAMPLES_AT_ONCE) if on_kernel(trace, jnp.float32) else 1


def strip_rows(film: Film, options: RenderOptions, trace: TraceOptions) -> int:
    """Number of rows of a picture that are traced at once.

    These are all rows, or as many whole tiles as `render.memory` allows, at least one.

    Args:
        film: size of the picture.
        options: how the picture is sampled.
        trace: options of the tracer.
    """
    ray, group = (
        RAY_OF_KERNEL if on_kernel(trace, jnp.float32) else RAY,
        samples_at_once(options, trace),
    )
    each = ray * group + SAMPLE * options.samples / group + PIXEL
    most = int(options.memory * 1e9 / (each * film.width))
    if most >= film.height:
        return film.height
    coarse = trace.bundle * 4**trace.levels
    step = coarse if most >= coarse else trace.bundle
    return min(max(most // step, 1) * step, film.height)


def strip_plan(
    film: Film, options: RenderOptions, trace: TraceOptions, gaussians: int
) -> tuple[int, TraceOptions]:
    """Number of rows that are traced at once (`strip_rows`), and the trace options for them.

    The more Gaussians there are, the more coarser levels of bundles.

    Args:
        film: size of the picture.
        options: how the picture is sampled.
        trace: options of the tracer.
        gaussians: number of Gaussians.
    """
    rows = strip_rows(film, options, trace)
    levels, deepest, each, most = trace.levels, 4, -(-gaussians // OCCUPANCY), _TESTS
    if on_cpu_kernel(trace, jnp.float32):
        deepest, each, most = CPU_LEVELS, gaussians, _CPU_TESTS

    def tests(side: int) -> int:
        return -(-film.width // side) * -(-rows // side) * each

    def side(levels: int) -> int:
        return trace.bundle * 4**levels

    if on_kernel(trace, jnp.float32):
        return rows, trace
    while levels < deepest and tests(side(levels)) > most and side(levels + 1) <= rows:
        levels += 1
    if trace.levels < levels and rows < film.height:
        rows -= rows % side(levels)
    return rows, dataclasses.replace(trace, levels=levels)


def strip_tops(height: int, rows: int) -> list[int]:
    """First rows of the strips of a picture; the last one may overlap the one before.

    Args:
        height: rows of the picture.
        rows: rows of a strip.
    """
    return [min(y, height - rows) for y in range(0, height, rows)]


def strip_part(film: Film, rows: int, trace: TraceOptions, top: int) -> tuple[Part, TraceOptions]:
    """A strip of rows as a part, and its trace options.

    Args:
        film: size of the picture.
        rows: number of rows.
        trace: options of the tracer.
        top: first row.
    """
    order = morton_tiles(film.width, rows, trace.bundle, trace.levels)
    return pixels_part(film, np.where(order < 0, order, order + top * film.width), trace, top)


def interleaved_parts(
    film: Film, trace: TraceOptions, devices: int, rows: int = 0, top: int = 0
) -> tuple[Part, TraceOptions, Array]:
    """A strip of rows as one part per device, of interleaved blocks of tiles, for even work.

    Args:
        film: size of the picture.
        trace: options of the tracer.
        devices: number of devices.
        rows: number of rows; 0 is the whole picture.
        top: first row.

    Returns:
        The stacked parts, the trace options, and the place of each pixel among the slots of all
        parts.
    """
    block, rows = trace.bundle**2 * FAN**trace.levels, rows or film.height
    order = morton_tiles(film.width, rows, trace.bundle, trace.levels).reshape(-1, block)
    order = np.where(order < 0, order, order + top * film.width)
    order = np.pad(order, ((0, -len(order) % devices), (0, 0)), constant_values=-1)
    order = order.reshape(-1, devices, block).swapaxes(0, 1).reshape(devices, -1)
    whole, trace = pixels_part(film, order.reshape(-1), trace, top)
    slots = jnp.arange(order.shape[1], dtype=jnp.int32)
    each = [Part(x, slots, whole.row) for x in whole.pixel.reshape(*order.shape, 2)]
    return jax.tree.map(lambda *x: jnp.stack(x), *each), trace, whole.slot


def pixels_part(
    film: Film, order: Int[np.ndarray, " slots"], trace: TraceOptions, top: int = 0
) -> tuple[Part, TraceOptions]:
    """Pixels in the order of ray bundles as a part, and its trace options.

    Args:
        film: size of the picture.
        order: row-major indices of the pixels of whole rows; -1 is padding, which repeats the pixel
            before it.
        trace: options of the tracer.
        top: first row.
    """
    if len(order) < trace.bundle**2 * 256:
        trace = dataclasses.replace(trace, levels=0)
    inside = np.flatnonzero(order >= 0)
    slot = inside[np.argsort(order[inside])].astype(np.int32)
    index = fill_padding(order)
    pixel = np.stack([index % film.width, index // film.width], axis=-1)
    middle = top + (len(inside) // film.width - 1) / 2
    place = to_device(pixel, jnp.float32), to_device(slot), to_device(middle, jnp.float32)
    return Part(*place), trace
