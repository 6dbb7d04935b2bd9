"""Candidates to pixels on a CUDA device: what grid, traverse and march do, in three kernels.

`gather` gives every 16 x 16 pixels one list of what they may meet, in the order of the least
distance, and `sift` marks which of their warps may meet it. In `forward` a warp takes eight
neighbouring rays through the list, four lanes to a ray: the lanes share the entries among them and
each keeps its nearest pending hits in registers. A hit is blended once nothing further down the
list can be nearer, so the order is exact, and the walk ends where the rays are spent. Hits without
room wait for another pass: k is a matter of speed alone. Hits at equal distance are taken in the
order of their Gaussians. `backward` walks again and adds up the gradients as it goes, in no fixed
order: they differ by rounding from run to run.

What was measured on the way (H200, 512 x 512, room of 200,000, the march alone): a ray to a lane
2.2 ms, bound by the longest walk; entries met first, hits sorted in afterwards 1.1; four lanes to a
ray 0.64; lists for 16 x 16 pixels instead of 32 x 32, with a bit for every warp 0.45. What is
wanted by one warp alone decides: 2,000 small discs before 32 pixels, where the mean is a hundred.

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
from gaussray.scene.gaussians import Gaussians, axes, whitening
from gaussray.tracer.cuda import launch, ptx
from gaussray.tracer.grid import OCCUPANCY, around, place
from gaussray.tracer.motion import (
    Motion,
    arc_weights,
    controls,
    ordinary,
    still,
    tint_controls,
    usable,
    whole,
)
from gaussray.tracer.response import reach


_SOURCE = Path(__file__).with_suffix(".cu")
# Cells in a box of the coarser grid, one for each thread of a warp.
_CELLS = 32
# Warps in a block of the march, and lanes of a warp that share a ray. Hits do not fall evenly to
# the lanes, so together they keep twice k.
_WARPS = 4
_LANES = 4
# Bundles that share a list: with 8 x 8 pixels in each, a bit of a mask stands for one warp.
_BUNDLES = 4
# Parts of a mask that are tested together first.
_FEW = 8
# Bytes of lists at once; larger pictures are traced in strips.
_MEMORY = 2 * 1024**3


class Rows(NamedTuple):
    """The Gaussians as the kernels read them, those that rest first.

    `extent` is the mean and the axes F to where alpha = alpha_min, `state` A = S^-1 R^T, mean,
    opacity, squared reach (-1 for what is never met) and the place among the moving or -1, `keyed`
    F, mean and tint of the control points of those that move, `color` the harmonics and a tint.
    """

    extent: Float[Array, "gaussians 12"]
    state: Float[Array, "gaussians 16"]
    keyed: Float[Array, "moving keys 16"]
    color: Float[Array, "gaussians columns"]


class Lists(NamedTuple):
    """What every group of rays may meet, `slots` places each: Gaussians in the order of the least
    distance, that distance, which warps of rays may meet it (a bit each), how many there are (more
    than `slots`: some are missing), and the groups in turn, longest lists first."""

    index: Int[Array, "groups slots"]
    bound: Float[Array, "groups slots"]
    mask: Int[Array, "samples groups slots"]
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

    @property
    def code(self) -> str:
        """PTX of the kernels."""
        macros = {name.upper(): value for name, value in self._asdict().items()}
        macros |= {"WARPS": _WARPS, "LANES": _LANES, "FEW": _FEW}
        return ptx(_SOURCE, macros | {"K": -(-2 * self.k // _LANES)})


class Strip(NamedTuple):
    """Rays whose lists fit into memory together: origin, direction, and where on the arcs of the
    motion they are (the shares of three control points, and the first of them)."""

    origin: Float[Array, "samples rays 3"]
    direction: Float[Array, "samples rays 3"]
    weight: Float[Array, "samples rays 4"]


class Stage(NamedTuple):
    """What all strips share: program, rows, and the boxes in the order of the grid."""

    program: Program
    rows: Rows
    boxes: tuple[Int[Array, " gaussians"], Float[Array, "cells 6"], Float[Array, "supers 6"]]
    strips: int
    skipped: Int[Array, ""]


def prepare(motion: Motion, rays: Rays, *, options, slots: int) -> tuple[Stage, Strip]:
    """Everything up to the candidates. Strips come first in the rays' axes, which are padded."""
    motion = whole(motion) if motion.keys == 1 else motion
    rows, box, kept, fine = _rows(motion, options.alpha_min)
    group = options.bundle**2 * (_BUNDLES if options.levels else 1)
    samples, count = rays.time.shape
    groups = max(-(-count // group), 1)
    strips = min(-(-groups * slots * 4 * (4 + samples) // _MEMORY), groups)
    groups = -(-groups // strips)
    boxes = _boxes(box, kept)
    program = Program(
        rays=groups * group,
        samples=samples,
        group=group,
        side=options.bundle,
        slots=slots,
        supers=boxes[2].shape[0],
        keys=motion.keys,
        harmonics=motion.gaussians.harmonics.shape[1],
        tinted=int(_tinted(motion)),
        columns=rows.color.shape[1],
        k=options.k,
        alpha_max=options.alpha_max,
        transmittance_min=options.transmittance_min,
    )

    def cut(x: Array) -> Array:
        missing = strips * program.rays - count
        x = jnp.pad(x, ((0, 0), (0, missing), (0, 0)))
        return jnp.moveaxis(x.reshape(samples, strips, program.rays, -1), 1, 0)

    weight = jnp.zeros((strips, 1, 1, 4), rays.time.dtype)
    if motion.keys > 1:
        share, first = arc_weights(motion.time, rays.time)
        weight = cut(jnp.concatenate([share, first[..., None].astype(share.dtype)], axis=-1))
    skipped = jnp.sum(~fine, dtype=jnp.int32)
    stage = Stage(program, rows, boxes, strips, skipped)
    return stage, Strip(cut(rays.origin), cut(rays.direction), weight)


def candidates(stage: Stage, strip: Strip) -> Lists:
    """The lists of one strip. No gradient."""
    program, (order, cell, super_) = stage.program, stage.boxes
    groups, code = program.rays // program.group, program.code
    warps = -(-program.group * _LANES // 32)
    parts = -(-warps // -(-warps // 32))
    clumps = -(-parts // _FEW)
    size = groups, program.slots
    integers, numbers = (jax.ShapeDtypeStruct(size, t) for t in (jnp.int32, jnp.float32))
    rows, strip = jax.lax.stop_gradient((stage.rows, strip))
    found, bound, bounds, count, _, _ = launch(
        "gather",
        code,
        (*strip, order, super_, cell, rows.extent, rows.state, rows.keyed),
        (
            integers,
            numbers,
            jax.ShapeDtypeStruct((program.samples, groups, parts + clumps, 24), jnp.float32),
            jax.ShapeDtypeStruct((groups,), jnp.int32),
            integers,
            numbers,
        ),
        blocks=groups,
        threads=256,
    )
    index, mask = launch(
        "sift",
        code,
        (found, bound, bounds, count, rows.extent, rows.state, rows.keyed),
        (integers, jax.ShapeDtypeStruct((program.samples, *size), jnp.int32)),
        blocks=program.samples * groups * -(-program.slots // 128),
        threads=128,
    )
    return Lists(index, bound, mask, count, jnp.argsort(-count).astype(jnp.int32))


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
    d_origin, d_direction, d_weight, d_state, d_color, d_keyed = launch(
        "backward",
        program.code,
        (*strip, *lists, *rows[1:], total, end, g_total, g_end),
        [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in strip],
        sums=[jnp.zeros_like(x) for x in (rows.state, rows.color, rows.keyed)],
        blocks=_blocks(program),
        threads=32 * _WARPS,
    )
    if program.keys == 1:
        d_weight = jnp.zeros_like(strip.weight)
    d_rows = Rows(jnp.zeros_like(rows.extent), d_state, d_keyed, d_color)
    return d_rows, Strip(d_origin, d_direction, d_weight), None


march = jax.custom_vjp(_march, nondiff_argnums=(0,))
march.defvjp(_march_forward, _march_backward)


def _blocks(program: Program) -> int:
    warps = program.rays // program.group * program.samples * -(-program.group * _LANES // 32)
    return -(-warps // _WARPS)


def _tinted(motion: Motion) -> bool:
    parts = (motion.gaussians, motion.rest)
    return any(g is not None and g.tint is not None for g in parts)


def _rows(motion: Motion, alpha_min: float) -> tuple[Rows, Array, Array, Array]:
    """Rows, boxes (lower and upper corner) around all there is, which Gaussians can be met at all,
    and which are usable."""
    tinted = _tinted(motion)
    if motion.keys == 1:
        g = motion.gaussians
        parts = [_resting(g, alpha_min, tinted)]
        keyed = jnp.zeros((1, 1, 16), g.mean.dtype)
    else:
        moving, keyed = _moving(motion, alpha_min, tinted)
        parts = [moving]
        if motion.rest is not None:
            parts.insert(0, _resting(still(motion.rest).gaussians, alpha_min, tinted))
    extent, state, color, box, kept, fine = (jnp.concatenate(x) for x in zip(*parts, strict=True))
    return Rows(jax.lax.stop_gradient(extent), state, keyed, color), box, kept, fine


def _resting(g: Gaussians, alpha_min: float, tinted: bool):
    """Extent, state, colour, box, kept and usable of Gaussians at one key."""
    fine = usable(g)
    g = ordinary(g, fine)
    mean, quat, scale = g.mean[0], g.quat[0], g.scale[0]
    radius = reach(jax.lax.stop_gradient(g.opacity), alpha_min)
    kept = fine & (radius > 0)
    support = jax.lax.stop_gradient(axes(quat, scale)) * radius[:, None, None]
    extent = jnp.concatenate([support.reshape(-1, 9), mean], axis=1)
    state = jnp.concatenate(
        [
            whitening(quat, scale).reshape(-1, 9),
            mean,
            _ends(g.opacity, radius, kept, jnp.full_like(radius, -1)),
        ],
        axis=1,
    )
    tint = None if not tinted else jnp.ones_like(mean) if g.tint is None else g.tint[0]
    lower, upper = around(jax.lax.stop_gradient(mean), support)
    box = jnp.concatenate([lower, upper], axis=1)
    return extent, state, _colors(g.harmonics, tint), box, kept, fine


def _moving(motion: Motion, alpha_min: float, tinted: bool):
    """The same for Gaussians with key states, and the rows of their control points."""
    fine = usable(motion.gaussians)
    g = ordinary(motion.gaussians, fine)
    motion = Motion(motion.time, g)
    mean, frame = controls(motion)
    radius = reach(jax.lax.stop_gradient(g.opacity), alpha_min)
    kept = fine & (radius > 0)
    tint = tint_controls(motion)
    keyed = [frame.reshape(*frame.shape[:2], 9), mean, tint, jnp.zeros_like(mean[..., :1])]
    keyed = jnp.moveaxis(jnp.concatenate(keyed, axis=-1), 0, 1)
    number = jnp.arange(g.count, dtype=mean.dtype)
    blank = jnp.zeros((g.count, 12), mean.dtype)
    state = jnp.concatenate([blank, _ends(g.opacity, radius, kept, number)], axis=1)
    lower, upper = around(*jax.lax.stop_gradient((mean, frame * radius[None, :, None, None])))
    box = jnp.concatenate([jnp.min(lower, axis=0), jnp.max(upper, axis=0)], axis=1)
    white = jnp.ones((g.count, 3), mean.dtype) if tinted else None
    return (blank, state, _colors(g.harmonics, white), box, kept, fine), keyed


def _ends(opacity: Array, radius: Array, kept: Array, number: Array) -> Array:
    """The last four columns of a state."""
    squared = jnp.where(kept, radius * radius, -1)
    return jnp.stack([opacity, squared, number, jnp.zeros_like(radius)], axis=1)


def _colors(harmonics: Array, tint: Array | None) -> Array:
    """Harmonics and tint in one row, a multiple of four floats."""
    parts = [harmonics.reshape(harmonics.shape[0], -1)] + ([] if tint is None else [tint])
    row = jnp.concatenate(parts, axis=1)
    return jnp.pad(row, ((0, 0), (0, -row.shape[1] % 4)))


def _boxes(box: Array, kept: Array) -> tuple[Array, Array, Array]:
    """Order of the Gaussians along the grid (-1 pads), boxes of cells and of _CELLS cells.

    What is empty is not a number: no comparison with it holds.
    """
    box = jax.lax.stop_gradient(box)
    lower, upper = box[:, :3], box[:, 3:]
    count = kept.shape[0]
    padding = max(-(-count // (OCCUPANCY * _CELLS)), 1) * OCCUPANCY * _CELLS - count
    order = jnp.argsort(place(lower, upper, kept).astype(jnp.uint32)).astype(jnp.int32)
    order = jnp.pad(order, (0, padding), constant_values=-1)
    signed = jnp.where(kept[:, None], jnp.concatenate([lower, -upper], axis=1), jnp.inf)
    signed = jnp.concatenate([signed, jnp.full((1, 6), jnp.inf, box.dtype)])[order]
    cell = jnp.min(signed.reshape(-1, OCCUPANCY, 6), axis=1)
    super_ = jnp.min(cell.reshape(-1, _CELLS, 6), axis=1)

    def corners(x: Array) -> Array:
        x = jnp.where(x[:, :1] < jnp.inf, x, jnp.nan)
        return jnp.concatenate([x[:, :3], -x[:, 3:]], axis=1)

    return order, corners(cell), corners(super_)
