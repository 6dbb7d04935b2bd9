"""Parts of a picture: the pixels that are traced at once, and how they are cut and ordered."""

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
from gaussray.render.segments import Share
from gaussray.tracer.bundle import FAN, fill_padding, morton_tiles
from gaussray.tracer.grid import OCCUPANCY
from gaussray.tracer.trace import TraceOptions, on_kernel


# Samples of a pixel that are traced at once and share what their bundle may meet. That saves a GPU
# most of the search; on a CPU the longer lists cost more (16 samples of a lens take 1.9 times as
# long).
_SAMPLES_AT_ONCE = 16
# Cells of the grid times bundles of the coarsest level, at most, where levels can be added: the
# answers of so many tests are in memory at once.
_TESTS = 1 << 26
# Bytes that a frame takes for each ray under way, its share of the lists included (1,000 Gaussians,
# 256 x 256 pixels, XLA's own count on a CPU: 584 in all; a kernel keeps less, by the sizes of its
# arrays), for each group of samples of a pixel, and for each pixel.
RAY, RAY_OF_KERNEL, SAMPLE, PIXEL = 520, 100, 20, 60


class Part(eqx.Module):
    """The pixels that are traced at once.

    `pixel` are indices (column, row) in the order of the ray bundles; padding repeats a pixel;
    `slot` is the place of each pixel in that order. `row` is the row whose time a chunk of rows
    uses. `share` are the rays of one segment where several segments of a clip show a frame. `batch`
    is the number of a batch of samples, None if there is only one. Parts of several devices may be
    stacked.
    """

    pixel: Float[Array, "*devices slots 2"]
    slot: Int[Array, "*devices pixels"]
    row: Float[Array, "*devices"]
    share: Share | None = None
    batch: Int[Array, "*devices"] | None = None


def whole_picture(film: Film, trace: TraceOptions) -> tuple[Part, TraceOptions]:
    """All pixels of a picture as one part, and its trace options: a small picture needs no coarser
    bundles."""
    order = morton_tiles(film.width, film.height, trace.bundle, trace.levels)
    return part_of(film, order, trace)


def samples_at_once(options: RenderOptions, trace: TraceOptions) -> int:
    """The number of samples of a pixel that are traced at once."""
    return math.gcd(options.samples, _SAMPLES_AT_ONCE) if on_kernel(trace, jnp.float32) else 1


def strip_rows(film: Film, options: RenderOptions, trace: TraceOptions) -> int:
    """The rows of a picture that are traced at once: all of them, or whole tiles, as many as
    `render.memory` allows for, and at least one."""
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


def strips(
    film: Film, options: RenderOptions, trace: TraceOptions, gaussians: int
) -> tuple[int, TraceOptions]:
    """The rows of a picture that are traced at once (`strip_rows`), and how: the more Gaussians,
    the coarser the bundles that all of their cells are tested against first."""
    rows = strip_rows(film, options, trace)
    cells, levels = -(-gaussians // OCCUPANCY), trace.levels

    def tests(side: int) -> int:
        return -(-film.width // side) * -(-rows // side) * cells

    def side(levels: int) -> int:
        return trace.bundle * 4**levels

    if on_kernel(trace, jnp.float32):
        return rows, trace
    while levels < 4 and tests(side(levels)) > _TESTS and side(levels + 1) <= rows:
        levels += 1
    if trace.levels < levels and rows < film.height:
        rows -= rows % side(levels)
    return rows, dataclasses.replace(trace, levels=levels)


def strip(film: Film, rows: int, trace: TraceOptions, top: int) -> tuple[Part, TraceOptions]:
    """The strip of so many rows from `top` on as a part."""
    order = morton_tiles(film.width, rows, trace.bundle, trace.levels)
    return part_of(film, np.where(order < 0, order, order + top * film.width), trace, top)


def interleaved(
    film: Film, trace: TraceOptions, devices: int, rows: int = 0, top: int = 0
) -> tuple[Part, TraceOptions, Array]:
    """A strip of so many rows from `top` on (0: the whole picture) as one part per device, stacked,
    of interleaved blocks of tiles, for even work; its trace options; and the place of each pixel
    among the slots of all parts."""
    block, rows = trace.bundle**2 * FAN**trace.levels, rows or film.height
    order = morton_tiles(film.width, rows, trace.bundle, trace.levels).reshape(-1, block)
    order = np.where(order < 0, order, order + top * film.width)
    order = np.pad(order, ((0, -len(order) % devices), (0, 0)), constant_values=-1)
    order = order.reshape(-1, devices, block).swapaxes(0, 1).reshape(devices, -1)
    whole, trace = part_of(film, order.reshape(-1), trace, top)
    slots = jnp.arange(order.shape[1], dtype=jnp.int32)
    each = [Part(x, slots, whole.row) for x in whole.pixel.reshape(*order.shape, 2)]
    return jax.tree.map(lambda *x: jnp.stack(x), *each), trace, whole.slot


def part_of(
    film: Film, order: Int[np.ndarray, " slots"], trace: TraceOptions, top: int = 0
) -> tuple[Part, TraceOptions]:
    """The pixels of `order` (row-major indices, whole rows from `top` on; -1 is padding, which
    repeats the pixel before it and is in no one's slot) as a part."""
    if len(order) < trace.bundle**2 * 256:
        trace = dataclasses.replace(trace, levels=0)
    inside = np.flatnonzero(order >= 0)
    slot = inside[np.argsort(order[inside])].astype(np.int32)
    index = fill_padding(order)
    pixel = np.stack([index % film.width, index // film.width], axis=-1)
    middle = top + (len(inside) // film.width - 1) / 2
    place = to_device(pixel, jnp.float32), to_device(slot), to_device(middle, jnp.float32)
    return Part(*place), trace
