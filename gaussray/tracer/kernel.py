"""Candidates to pixels on a CUDA device: what grid, traverse and march do, in three kernels.

`gather` gives every 16 x 16 pixels one list of what they may meet, in the order of the least
distance, and `sift` marks which of their warps may meet it: those where a column and a row of
pixels cross that both do. In `forward` a warp takes eight neighbouring rays through the list, four
lanes to a ray: the lanes share the entries among them and each keeps its nearest pending hits in
registers. Hits are blended once nothing further down the list can be nearer, so the order is exact,
and the walk ends where the rays are spent. Hits without room wait for another pass: k is a matter
of speed alone. Hits at equal distance are taken in the order of the list. `backward` walks
again and adds up the gradients as it goes, in no fixed order: they differ by rounding from run to
run.

What was measured on the way (H200, 512 x 512, room of 200,000, the march alone): a ray to a lane
2.2 ms, bound by the longest walk; entries met first, hits sorted in afterwards 1.1; four lanes to a
ray 0.64; lists for 16 x 16 pixels instead of 32 x 32, with a bit for every warp 0.45. With 16
samples of a lens: the lanes of a ray blending what they hold together, colours read 16 bytes at a
time and words of bits instead of a mask for each entry, 9.2 to 6.7 ms; columns and rows tested
instead of warps, 1.2 to 0.37 ms for `sift`. What is wanted by one warp alone decides: 2,000 small
discs before 32 pixels, where the mean is a hundred.

Why CUDA C++ through NVRTC and XLA's PTX call. Pallas' Triton lowering says itself that it will be
removed; its tensor programs cannot end one ray's work while others go on, and a prototype of this
march in it took 1.5 ms. Pallas' Mosaic lowering wants a Hopper GPU or newer. A compiled extension
needs a wheel for every platform and CUDA version. CUDA C++ is what will still be there in two
years: the source is compiled when the program is traced, by the compiler that JAX's CUDA wheels
bring along, for whatever NVIDIA GPU is there; XLA then launches it like its own kernels, in CUDA
graphs too. The one thing that is XLA's own affair is the name of that call, in cuda.py alone.
"""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from gaussray.camera.rays import Rays
from gaussray.tracer.cuda import launch, ptx
from gaussray.tracer.kernel_layout import Rows, boxes_of, coefficients, is_tinted, rows_of
from gaussray.tracer.motion import Motion, arc_weights, clipped_time, with_rest


_SOURCE = Path(__file__).with_suffix(".cu")
# Warps in a block of the march, and lanes of a warp that share a ray. Hits do not fall evenly to
# the lanes, so together they keep twice k.
_WARPS = 4
_LANES = 4
# Bundles that share a list: with 8 x 8 pixels in each, a bit of a mask stands for one warp.
_BUNDLES = 4
# Bytes of lists at once; larger pictures are traced in strips.
_MEMORY = 2 * 1024**3


class Lists(NamedTuple):
    """What every group of rays may meet, `slots` places each: Gaussians in the order of the least
    distance, that distance, for every warp of rays which of them it may meet (a bit each), how many
    there are (more than `slots`: some are missing), and the groups in turn, longest lists first."""

    index: Int[Array, "groups slots"]
    bound: Float[Array, "groups slots"]
    met: Int[Array, "samples groups words parts"]
    count: Int[Array, " groups"]
    turn: Int[Array, " groups"]


class Program(NamedTuple):
    """The macros of kernel.cu."""

    rays: int
    samples: int
    group: int
    side: int
    slots: int
    supers: int
    keys: int
    harmonics: int
    tinted: int
    columns: int
    k: int
    alpha_max: float
    transmittance_min: float
    transient: int = 0

    @property
    def code(self) -> str:
        """PTX of the kernels."""
        macros = {name.upper(): value for name, value in self._asdict().items()}
        macros |= {"WARPS": _WARPS, "LANES": _LANES, "BROAD": self.broad, "ACROSS": self.across}
        return ptx(_SOURCE, macros | {"K": -(-2 * self.k // _LANES)})

    @property
    def warps(self) -> int:
        """Warps of the march to a group."""
        return -(-self.group * _LANES // 32)

    @property
    def parts(self) -> int:
        """Parts of a group that have a bit, at most 32: a warp each, or several."""
        return -(-self.warps // -(-self.warps // 32))

    @property
    def across(self) -> int:
        """Bundles of a group side by side."""
        return 2 if self.group == _BUNDLES * self.side**2 else 1

    @property
    def broad(self) -> int:
        """Pixels in a row of a warp: of 8 x 8 pixels it takes 4 x 2, which are met by less than
        8 x 1; with key states those, which a rolling shutter reads at once. 0 where bundles are of
        another size."""
        if self.side != 8 or _LANES != 4:
            return 0
        return 4 if self.keys == 1 else 8

    @property
    def bands(self) -> int:
        """Columns and rows of parts."""
        if not self.broad:
            return self.parts
        return self.across * (8 // self.broad + self.broad)


class Strip(NamedTuple):
    """Rays whose lists fit into memory together: origin, direction, where on the arcs of the motion
    they are (the shares of three control points, and the first of them), and the time, which only
    transient Gaussians ask for."""

    origin: Float[Array, "samples rays 3"]
    direction: Float[Array, "samples rays 3"]
    weight: Float[Array, "samples rays 4"]
    time: Float[Array, "samples rays 1"]


class Stage(NamedTuple):
    """What all strips share: program, rows, and the boxes in the order of the grid."""

    program: Program
    rows: Rows
    boxes: tuple[Int[Array, " gaussians"], Float[Array, "cells 6"], Float[Array, "supers 6"]]
    strips: int
    skipped: Int[Array, ""]


def stage_and_strips(
    motion: Motion, rays: Rays, span: Float[Array, "2"], *, options, slots: int
) -> tuple[Stage, Strip]:
    """Everything up to the candidates. Strips come first in the rays' axes, which are padded.

    All times of the rays are in the span.
    """
    motion = with_rest(motion) if motion.keys == 1 else motion
    rows, box, kept, fine = rows_of(motion, options.alpha_min, span)
    group = options.bundle**2 * (_BUNDLES if options.levels else 1)
    samples, count = rays.time.shape
    groups = max(-(-count // group), 1)
    strips = min(-(-groups * slots * 4 * (4 + samples) // _MEMORY), groups)
    groups = -(-groups // strips)
    boxes = boxes_of(box, kept)
    program = Program(
        rays=groups * group,
        samples=samples,
        group=group,
        side=options.bundle,
        slots=slots,
        supers=boxes[2].shape[0],
        keys=motion.keys,
        harmonics=coefficients(motion),
        tinted=int(is_tinted(motion)),
        columns=rows.color.shape[1],
        k=options.k,
        alpha_max=options.alpha_max,
        transmittance_min=options.transmittance_min,
        transient=int(motion.transient is not None),
    )

    def cut(x: Array) -> Array:
        missing = strips * program.rays - count
        x = jnp.pad(x, ((0, 0), (0, missing), (0, 0)))
        return jnp.moveaxis(x.reshape(samples, strips, program.rays, -1), 1, 0)

    weight = jnp.zeros((strips, 1, 1, 4), rays.time.dtype)
    if motion.keys > 1:
        share, first = arc_weights(motion.time, rays.time)
        weight = cut(jnp.concatenate([share, first[..., None].astype(share.dtype)], axis=-1))
    time = jnp.zeros((strips, 1, 1, 1), rays.time.dtype)
    if motion.transient is not None:
        time = cut(clipped_time(motion.time_range, rays.time)[..., None])
    skipped = jnp.sum(~fine, dtype=jnp.int32)
    stage = Stage(program, rows, boxes, strips, skipped)
    return stage, Strip(cut(rays.origin), cut(rays.direction), weight, time)


def candidate_lists(stage: Stage, strip: Strip) -> Lists:
    """The lists of one strip. No gradient."""
    program, (order, cell, super_) = stage.program, stage.boxes
    groups, code = program.rays // program.group, program.code
    size = groups, program.slots
    bands = program.samples, groups, program.bands, 28 if program.transient else 24
    integers, numbers = (jax.ShapeDtypeStruct(size, t) for t in (jnp.int32, jnp.float32))
    rows, strip = jax.lax.stop_gradient((stage.rows, strip))
    index, bound, bounds, count, _, _ = launch(
        "gather",
        code,
        (*strip, order, super_, cell, rows.extent, rows.state, rows.keyed, rows.window),
        (
            integers,
            numbers,
            jax.ShapeDtypeStruct(bands, jnp.float32),
            jax.ShapeDtypeStruct((groups,), jnp.int32),
            integers,
            numbers,
        ),
        blocks=groups,
        threads=256,
    )
    words = program.samples, groups, -(-program.slots // 32), program.parts
    (met,) = launch(
        "sift",
        code,
        (index, bounds, count, rows.extent, rows.state, rows.keyed, rows.window),
        (jax.ShapeDtypeStruct(words, jnp.int32),),
        blocks=groups * -(-program.slots // 128),
        threads=128,
    )
    return Lists(index, bound, met, count, jnp.argsort(-count).astype(jnp.int32))


def _march(
    program: Program, rows: Rows, strip: Strip, lists: Lists
) -> tuple[
    Float[Array, "samples rays 4"], Float[Array, "samples rays"], Int[Array, "samples rays"]
]:
    """Red, green, blue and depth, transmittance, and number of hits of every ray."""
    size = program.samples, program.rays
    sums, transmittance, hits = launch(
        "forward",
        program.code,
        (*strip, *lists, *rows[1:]),
        (
            jax.ShapeDtypeStruct((*size, 4), jnp.float32),
            jax.ShapeDtypeStruct(size, jnp.float32),
            jax.ShapeDtypeStruct(size, jnp.int32),
        ),
        blocks=_blocks(program),
        threads=32 * _WARPS,
    )
    return sums, transmittance, hits


def _march_forward(program, rows, strip, lists):
    out = _march(program, rows, strip, lists)
    return out, (rows, strip, lists, out[0], out[1])


def _march_backward(program, saved, cotangent):
    rows, strip, lists, total, end = saved
    g_total, g_end, _ = cotangent
    d_origin, d_direction, d_weight, d_time, d_state, d_color, d_keyed, d_window = launch(
        "backward",
        program.code,
        (*strip, *lists, *rows[1:], total, end, g_total, g_end),
        [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in strip],
        sums=[jnp.zeros_like(x) for x in (rows.state, rows.color, rows.keyed, rows.window)],
        blocks=_blocks(program),
        threads=32 * _WARPS,
    )
    if program.keys == 1:
        d_weight = jnp.zeros_like(strip.weight)
    if not program.transient:
        d_time = jnp.zeros_like(strip.time)
    d_rows = Rows(jnp.zeros_like(rows.extent), d_state, d_keyed, d_color, d_window)
    return d_rows, Strip(d_origin, d_direction, d_weight, d_time), None


march_kernel = jax.custom_vjp(_march, nondiff_argnums=(0,))
march_kernel.defvjp(_march_forward, _march_backward)


def _blocks(program: Program) -> int:
    return -(-program.rays // program.group * program.samples * program.warps // _WARPS)
