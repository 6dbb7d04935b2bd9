"""How long the lists of a trace must be: measured before, enlarged where they were too short."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from gaussray.camera.rays import Rays, moved_to_start
from gaussray.tracer import kernel
from gaussray.tracer.motion import Motion
from gaussray.tracer.options import TraceOptions, grid_levels, on_kernel
from gaussray.tracer.prepare import prepare, prepare_for_rays, time_span
from gaussray.tracer.trace import find_candidates, map_leading, slot_needs, with_sample_axis
from gaussray.tracer.traverse import Capacity, enlarged_size


# Room in lists beyond what was needed, for other frames and steps.
HEADROOM = 1.5
# Places of a list of the CUDA kernel, which take little memory: more than all but the deepest of
# fitted scenes need (experiments/captures/log.md).
_KERNEL_SLOTS = 1 << 14


def kernel_capacity(levels: int, transient: int = 0) -> Capacity:
    """List sizes for the CUDA kernel that need no measurement: nearly all lists fit.

    Args:
        levels: for how many levels of bundles cells are found (`grid_levels`).
        transient: places for transient Gaussians that are alive.
    """
    return Capacity((1,) * levels, 1, _KERNEL_SLOTS, transient)


@eqx.filter_jit
def _needed_sizes(
    motion, rays, *, options, capacity
) -> tuple[Int[Array, " sizes"], Int[Array, ""]]:
    """The list sizes that scene and rays want, and how many entries find no place."""
    if on_kernel(options, rays.time.dtype):
        rays = moved_to_start(with_sample_axis(rays))
        scene = prepare_for_rays(motion, rays, options, capacity)
        stage, strips = kernel.kernel_inputs(
            scene.motion, rays, scene.span, options=options, slots=capacity.slots
        )
        counts = map_leading(lambda strip: kernel.candidate_lists(stage, strip).count, strips)
        return scene.with_transient_count(*slot_needs(counts, capacity))
    lists, _ = find_candidates(motion, rays, options=options, capacity=capacity)
    return lists.needed, lists.dropped


@eqx.filter_jit
def _alive_count(motion: Motion, rays: Rays, options: TraceOptions) -> Int[Array, ""]:
    """How many transient Gaussians some ray may meet."""
    none = Capacity((), 0, 0)
    scene = prepare(motion, time_span(rays), options=options, capacity=none)
    return jnp.zeros((), jnp.int32) if scene.living is None else scene.living.needed


def measure(
    motion: Motion,
    rays: Rays,
    *,
    options: TraceOptions,
    capacity: Capacity | None = None,
    headroom: float = HEADROOM,
) -> Capacity:
    """Measure the list sizes of a trace. On the host, outside jit.

    Args:
        motion: the scene across the times of the rays.
        rays: the rays.
        options: options of the tracer.
        capacity: sizes to start from, enlarged until none overflows; None is a small guess.
        headroom: factor of the needed sizes, for other frames and steps.
    """
    trial = capacity
    if trial is None:
        levels = grid_levels(options, rays.time.dtype)
        bundles = -(-rays.time.shape[-1] // options.bundle**2)
        if on_kernel(options, rays.time.dtype):
            # Too short ones would cost a compilation.
            trial = kernel_capacity(levels)
        else:
            trial = Capacity((256 * bundles,) * levels, 512 * bundles, 1024)
    if motion.transient is not None and not trial.transient:
        # Known without a search, and all other sizes depend on it.
        trial = replace(trial, transient=max(int(_alive_count(motion, rays, options)), 1))
    while True:
        needed, dropped = _needed_sizes(motion, rays, options=options, capacity=trial)
        needed = [int(n) for n in needed]
        wanted = enlarged_capacity(trial, needed, headroom=headroom)
        if int(dropped) == 0:
            least = Capacity((1,) * len(trial.cells), 1, 1)
            return enlarged_capacity(least, needed, headroom=headroom)
        trial = wanted


def enlarged_capacity(
    capacity: Capacity, needed: list[int], *, headroom: float = HEADROOM
) -> Capacity:
    """Enlarge every size that is exceeded, or used to more than 0.8.

    Enlarging all of them at once saves compilations. Slots are rounded up to a power of two.

    Args:
        capacity: the sizes.
        needed: the needed sizes (`Report.needed`).
        headroom: factor of the needed sizes.
    """
    grown = partial(enlarged_size, headroom=headroom)
    levels = len(capacity.cells)
    cells, (pairs, slots, *transient) = needed[:levels], needed[levels:]
    return Capacity(
        cells=tuple(grown(h, w) for h, w in zip(capacity.cells, cells, strict=True)),
        pairs=grown(capacity.pairs, pairs),
        slots=1 << max(grown(capacity.slots, slots, near=1.0) - 1, 1).bit_length(),
        transient=grown(capacity.transient, *transient) if transient else capacity.transient,
    )
