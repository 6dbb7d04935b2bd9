"""The tracer on a CUDA device: lists and march in four kernels of CUDA C++.

- `gather` gives every 16 x 16 pixels one list of the Gaussians they may meet, in the order of the
  least distance at which a ray of theirs may peak in them. `sift` marks which warps of these pixels
  may meet each entry: those where a column and a row of pixels that may meet it cross.
- `forward` marches a warp of two to eight neighbouring rays through the list, with 16 to four lanes
  per ray. The lanes share the entries among them; each keeps its nearest pending hits in registers,
  and the next ones in a heap. A hit is blended once no later entry can be nearer, so the order is
  exact, and a ray stops when its transmittance is spent. Hits that do not fit wait for another
  pass, so k affects only speed. Hits at equal distance are blended in the order of the list.
- `backward` marches again and adds up the gradients in no fixed order: they differ by rounding from
  run to run.

Measurements behind this design (H200, 512 x 512, room of 200,000, the march alone): one lane per
ray 2.2 ms, limited by the longest ray; entries tested first, hits sorted afterwards 1.1 ms; four
lanes per ray 0.64 ms; lists for 16 x 16 pixels instead of 32 x 32, with a bit per warp, 0.45 ms.
With 16 samples of a lens: lanes of a ray that blend together, colours read 16 bytes at a time, and
words of bits instead of a mask per entry, 9.2 to 6.7 ms; columns and rows tested instead of warps,
1.2 to 0.37 ms for `sift`. Single warps with long lists decide: 2,000 small discs before 32 pixels,
where the mean is a hundred. With a heap 0.32 ms instead of 0.39, with gradients 0.86 instead of
1.02. Of a fitted scene (115 hits a ray, 64 scattered tiles of 32 x 32 pixels) with gradients: 7.4
ms; with a heap 6.4; with 8 lanes per ray 4.6, with 16 lanes 3.9: one warp of 8,192 had taken longer
than the GPU took for all the others.

Why CUDA C++ through NVRTC and XLA's PTX call: Pallas' Triton lowering announces its own removal,
and its tensor programs cannot end one ray while others continue; a prototype of this march in it
took 1.5 ms. Pallas' Mosaic lowering needs a Hopper GPU or newer. A compiled extension needs a wheel
for every platform and CUDA version. Here the source is compiled when a program is traced, by the
compiler of JAX's CUDA wheels, for the GPU that is present; XLA launches it like its own kernels, in
CUDA graphs too. Only the name of that call is internal to XLA; it is in cuda.py alone.
"""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from gaussray.camera.rays import Rays
from gaussray.runtime.cuda import launch, ptx
from gaussray.tracer.kernel_layout import Rows, gaussian_rows, grid_boxes, harmonic_count, is_tinted
from gaussray.tracer.motion import Motion, arc_weights, clipped_time, merge_rest


_SOURCE = Path(__file__).with_suffix(".cu")
# Warps in a block of the march.
_WARPS = 4
# Lanes of a warp that share a ray, by the largest number of rays for which there are so many: the
# fewer warps there are, the more the longest one delays. Above the last number there are four.
_LANES = {1 << 16: 16, 1 << 17: 8}
# Bundles that share a list: with 8 x 8 pixels in each, a bit of a mask stands for one warp.
_BUNDLES = 4
# Macros that are numbers in the PTX: others do not have to be compiled.
_NUMBERS = ("RAYS", "SLOTS", "SUPERS")
# Threads that keep a GPU busy, of the blocks that list what groups may meet.
_BUSY = 1 << 18
# Largest size of the lists in bytes; larger pictures are traced in strips.
_MEMORY = 2 * 1024**3


class Lists(NamedTuple):
    """The Gaussians that each group of rays may meet, in `slots` places.

    Args:
        index: the Gaussians, in order of the least distance at which a ray may peak in them.
        bound: that distance, or less.
        met: a bit for each entry and warp of rays: whether the warp may meet the entry.
        count: number of entries; above `slots` some are missing.
        turn: the groups in the order in which they are marched, longest lists first.
    """

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
    lanes: int = 4

    @property
    def code(self) -> str:
        """PTX of the kernels."""
        macros = {name.upper(): value for name, value in self._asdict().items()}
        numbers = {name: macros.pop(name) for name in _NUMBERS}
        macros |= {"WARPS": _WARPS, "BROAD": self.broad, "ACROSS": self.across, "TEAM": self.team}
        # Hits are not distributed evenly over the lanes of a ray, so together they keep 2 k.
        code = ptx(_SOURCE, macros | {"K": -(-2 * self.k // self.lanes)})
        for name, number in numbers.items():
            code = code.replace(f"NUMBER_OF_{name}", str(number))
        return code

    @property
    def team(self) -> int:
        """Threads that list what a group of rays may meet: more where there are few groups."""
        groups = self.rays // self.group
        return 1024 if groups <= _BUSY // 1024 else 512 if groups <= _BUSY // 512 else 256

    @property
    def warps(self) -> int:
        """Warps of the march to a group."""
        return -(-self.group * self.lanes // 32)

    @property
    def parts(self) -> int:
        """Parts of a group that have a bit of their own, at most 32: one warp each, or several."""
        return -(-self.warps // -(-self.warps // 32))

    @property
    def across(self) -> int:
        """Number of bundles of a group that lie side by side."""
        return 2 if self.group == _BUNDLES * self.side**2 else 1

    @property
    def broad(self) -> int:
        """Pixels of a warp in a row; 0 if bundles are not 8 x 8 pixels, or warps are smaller.

        A warp of eight rays takes 4 x 2 pixels, which meet fewer Gaussians than 8 x 1. With key
        states it takes 8 x 1, which a rolling shutter exposes at the same time.
        """
        if self.side != 8 or self.lanes != 4:
            return 0
        return 4 if self.keys == 1 else 8

    @property
    def bands(self) -> int:
        """Number of columns and rows of parts."""
        if not self.broad:
            return self.parts
        return self.across * (8 // self.broad + self.broad)


class Strip(NamedTuple):
    """Rays whose lists fit into memory together.

    `weight` holds the weights of three control points of the motion and the index of the first of
    them; `time` is used by transient Gaussians alone.
    """

    origin: Float[Array, "samples rays 3"]
    direction: Float[Array, "samples rays 3"]
    weight: Float[Array, "samples rays 4"]
    time: Float[Array, "samples rays 1"]


class KernelInputs(NamedTuple):
    """What all strips share: program, rows, and the boxes in the order of the grid."""

    program: Program
    rows: Rows
    boxes: tuple[Int[Array, " gaussians"], Float[Array, "cells 6"], Float[Array, "supers 6"]]
    skipped: Int[Array, ""]


def kernel_inputs(
    motion: Motion, rays: Rays, span: Float[Array, "2"], *, options, slots: int
) -> tuple[KernelInputs, Strip]:
    """What the lists of rays are made from: the stage, and the strips, in a leading axis.

    The last strip is padded with rays of direction zero, which hit nothing.

    Args:
        motion: the scene across the times of the rays (`Prepared.motion`).
        rays: rays in a coherent order, with a leading axis of samples.
        span: first and last time, between which are all times of the rays, in the capture's unit.
        options: how to trace.
        slots: number of Gaussians that a list holds.
    """
    motion = merge_rest(motion) if motion.keys == 1 else motion
    rows, box, kept, fine = gaussian_rows(motion, options.alpha_min, span)
    group = options.bundle**2 * (_BUNDLES if options.levels else 1)
    samples, count = rays.time.shape
    groups = max(-(-count // group), 1)
    strips = min(-(-groups * slots * 4 * (4 + samples) // _MEMORY), groups)
    groups = -(-groups // strips)
    boxes = grid_boxes(box, kept)
    program = Program(
        rays=groups * group,
        samples=samples,
        group=group,
        side=options.bundle,
        slots=slots,
        supers=boxes[2].shape[0],
        keys=motion.keys,
        harmonics=harmonic_count(motion),
        tinted=int(is_tinted(motion)),
        columns=rows.color.shape[1],
        k=options.k,
        alpha_max=options.alpha_max,
        transmittance_min=options.transmittance_min,
        transient=int(motion.transient is not None),
        lanes=next((_LANES[most] for most in sorted(_LANES) if samples * count <= most), 4),
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
    stage = KernelInputs(program, rows, boxes, skipped)
    return stage, Strip(cut(rays.origin), cut(rays.direction), weight, time)


def candidate_lists(stage: KernelInputs, strip: Strip) -> Lists:
    """The lists of one strip. No gradient.

    Args:
        stage: the stage of `kernel_inputs`.
        strip: one of its strips, without the leading axis.
    """
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
        threads=program.team,
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
