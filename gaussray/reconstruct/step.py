"""A block of training steps in one compiled program: loss, gradients, Adam, exploration."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Int

from gaussray.camera.array import CameraSet, pixel_spacing
from gaussray.camera.camera import Camera
from gaussray.reconstruct.block_sizes import BlockSizes
from gaussray.reconstruct.data.batches import Batch
from gaussray.reconstruct.optimize import relocation
from gaussray.reconstruct.optimize.learning_rates import CaptureScale, rates
from gaussray.reconstruct.optimize.optimizer import descend, scene_of, with_density_costs
from gaussray.reconstruct.optimize.scale_bounds import scale_bounds, with_scale_bounds
from gaussray.reconstruct.optimize.smooth_motion import spread_over_time
from gaussray.reconstruct.optimize.state import State, accumulated_statistics
from gaussray.reconstruct.run_progress import StageSchedule
from gaussray.reconstruct.step_loss import (
    StepOptions,
    density_costs,
    loss_of,
    step_motion,
    step_rays,
)
from gaussray.runtime.program_cache import step_jit
from gaussray.tracer.measure import measure
from gaussray.tracer.options import on_kernel
from gaussray.tracer.traverse import enlarged_size
from gaussray.tracer.visible_subset import seen_counts, seen_part


# Tiles of a step up to which it pays to look for the Gaussians that they see before tracing, and
# the share of all Gaussians from which on all are traced.
_MOST_BLOCKS, _FEW = 16, 0.7
# Room for steps that see more Gaussians than those that were measured, and for longer lists. Lists
# of what is seen alone differ more from step to step: several tiles may look at one place.
_MORE_SEEN, _LONGER, _LONGER_SEEN = 1.6, 2.0, 4.0


class StepSchedule(eqx.Module):
    """How much of a stage is done at its steps, by which the rates fall, and the seed of the steps'
    noise.

    Arrays, so that other values compile nothing.
    """

    stage: StageSchedule
    seed: Int[Array, ""]


def step_schedule(stage: StageSchedule, seed: int) -> StepSchedule:
    """The schedule of a stage.

    Args:
        stage: how much of the stage is done at its steps.
        seed: seed of the steps' noise.
    """
    steps, begin = (jnp.asarray(n, jnp.int32) for n in (stage.steps, stage.begin))
    known = StageSchedule(steps, begin, jnp.asarray(stage.share, jnp.float32))
    return StepSchedule(known, jnp.asarray(seed, jnp.int32))


def measure_sizes(
    state: State,
    views: Camera,
    batches: Batch,
    cameras: CameraSet,
    *,
    options: StepOptions,
    mesh: Mesh,
    keys: int = 1,
    growth: float = 1.0,
) -> BlockSizes:
    """The sizes to compile a block of steps for: a multiple of those that its first step needs, as
    steps see different tiles.

    Args:
        state: the state before the block.
        views: the recorded cameras of all training frames, stacked.
        batches: the tiles of every step, with a leading axis of steps.
        cameras: the set of training cameras.
        options: how a step renders.
        mesh: the devices that share the rays.
        keys: the number of key states of the scene across a step.
        growth: factor by which the lists are expected to grow until the stage ends.
    """

    def traced(state, views, batch, cameras):
        rays, _ = step_rays(state.parameters, views, batch, cameras, state.step, options)
        scene = scene_of(state.parameters, jnp.zeros(2), cameras.times)
        return step_motion(scene, rays, batch.time, cameras, keys), rays

    @eqx.filter_jit
    def counts(state, views, batches, cameras):
        def of_step(batch):
            motion, rays = traced(state, views, batch, cameras)
            return seen_counts(motion, rays, blocks=tiles, options=options.trace)

        return jax.lax.map(of_step, batches)

    @eqx.filter_jit
    def first_step(state, views, batch, cameras, places):
        motion, rays = traced(state, views, batch, cameras)
        if places is not None:
            motion = seen_part(motion, rays, blocks=tiles, places=places, options=options.trace)[0]
        return motion, jax.tree.map(lambda x: x[:, : -(-x.shape[1] // mesh.size)], rays)

    tiles, places = batches.tile.shape[1], None
    first = jax.tree.map(lambda x: x[0], batches)
    if tiles <= _MOST_BLOCKS and not on_kernel(options.trace, views.time.dtype):
        seen = np.asarray(counts(state, views, batches, cameras))
        rows = [part.mean.shape[0] for part in state.parameters.kinds.values()]
        # Their number grows with that of all.
        places = _places(seen.max(axis=0), sum(rows[:2]), sum(rows[2:]), growth**2)
    motion, rays = first_step(state, views, first, cameras, places)
    longer = growth * (_LONGER if places is None else _LONGER_SEEN)
    capacity = measure(motion, rays, options=options.trace, headroom=longer)
    return BlockSizes(capacity, mesh, keys, places)


def _places(
    seen: Int[np.ndarray, "2"], persistent: int, transient: int, growth: float
) -> tuple[int, int] | None:
    """Places for what the tiles of a step see; None where that is most of the Gaussians anyway."""
    wanted = [enlarged_size(0, int(n), headroom=_MORE_SEEN * growth) for n in seen]
    kept, brief = (min(n, rows) for n, rows in zip(wanted, (persistent, transient), strict=True))
    few = kept + brief < _FEW * (persistent + transient)
    return (max(kept, 1), max(brief, 1)) if few else None


@step_jit
def train_block(
    state: State,
    views: Camera,
    batches: Batch,
    cameras: CameraSet,
    *,
    options: StepOptions,
    schedule: StepSchedule,
    sizes: BlockSizes,
):
    """A block of steps. If the tracer dropped list entries, the block is void: run it again with
    enlarged sizes.

    Args:
        state: the state before the block.
        views: the recorded cameras of all training frames, stacked.
        batches: the tiles of every step, with a leading axis of steps.
        cameras: the set of training cameras.
        options: the options of a step.
        schedule: how much of the stage is done, with which the rates fall, and seed.
        sizes: what the block is compiled for.

    Returns:
        The state after the block, the terms of the loss (unweighted, as means over the steps), the
        error of every tile (its mean absolute difference, (steps, tiles)), the largest list sizes
        needed, and how many list entries were dropped.
    """

    # Once for the block: distances to the cameras hardly change within one.
    bounds = scale_bounds(state.parameters, cameras, options.footprint)
    kinds = state.parameters.kinds
    spacing = {kind: pixel_spacing(cameras, free.mean) for kind, free in kinds.items()}
    deformation, at_rest = state.parameters.deformation, None
    if options.at_rest and deformation is not None and deformation.control is not None:
        at_rest = pixel_spacing(cameras, deformation.control.pivot)

    def step(state: State, batch: Batch):
        slope = jax.value_and_grad(loss_of, has_aux=True)
        cost_slope = jax.grad(density_costs, has_aux=True)
        share = schedule.stage.share_at(state.step)
        ignore_moving = share >= 0.5 if options.still else None
        (_, details), gradient = slope(
            *(state.parameters, views, batch, cameras, state.step),
            options=options,
            sizes=sizes,
            ignore_moving=ignore_moving,
        )
        if options.at_rest:
            gradient = spread_over_time(gradient)
        cost_gradient, costs = cost_slope(state.parameters, batch.time, cameras, options.density)
        rate = rates(
            state.parameters,
            state.step,
            options=options.optimizer,
            scale=CaptureScale(spacing, cameras.extent, cameras.interval, at_rest),
            share=share,
            refine=options.refine,
            formed=options.formed,
            degree_interval=options.degree_interval,
        )
        static, moving, transient = accumulated_statistics(state, gradient, details.origin)
        parameters, adam = descend(state.parameters, gradient, state.adam, rate)
        if options.density.relocates:
            parameters = with_density_costs(parameters, cost_gradient, adam, rate)
        parameters = with_scale_bounds(parameters, bounds)
        state = State(parameters, adam, static, moving, state.step + 1, transient)
        report = details.report
        return state, (details.terms | costs, details.error, report.needed, report.dropped)

    state, (terms, error, needed, dropped) = jax.lax.scan(step, state, batches)
    state = _explored(state, cameras, schedule, batches.tile.shape[0], options)
    terms, needed = jax.tree.map(jnp.mean, terms), jnp.max(needed, axis=0)
    result = state, terms, error, needed, jnp.sum(dropped)
    # Every host reads the result.
    return jax.lax.with_sharding_constraint(result, NamedSharding(sizes.mesh, PartitionSpec()))


def _explored(
    state: State, cameras: CameraSet, schedule: StepSchedule, steps: int, options: StepOptions
) -> State:
    """Noise on the positions of faint Gaussians, if they are relocated: that of all steps of a
    block at once, as it takes as long as a fifth of a step on a CPU."""
    density = options.density
    if not density.relocates or not density.noise:
        return state
    fall = options.optimizer.decay ** schedule.stage.share_at(state.step)
    key = jax.random.fold_in(jax.random.key(schedule.seed), state.step)
    kinds = state.parameters.kinds
    explore = partial(
        relocation.explore, size=density.noise * fall, extent=cameras.extent, steps=steps
    )
    keys = jax.random.split(key, len(kinds))
    moved = [explore(free, own) for free, own in zip(kinds.values(), keys, strict=True)]
    return eqx.tree_at(lambda s: [*s.parameters.kinds.values()], state, moved)
