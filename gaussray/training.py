"""One block of training steps, compiled: rays, loss, gradients, Adam, without the host."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from gaussray.capture.batches import Footage, tile_rays
from gaussray.color import srgb_encode
from gaussray.fit import loss as losses, regularizer
from gaussray.fit.loss import LossOptions
from gaussray.fit.optimizer import OptimizerOptions, Parameters, descend, rates, scene_of
from gaussray.fit.state import State, watch
from gaussray.scene.scene import Scene, at
from gaussray.tracer.motion import still
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.trace import TraceOptions, enlarge, measure
from gaussray.tracer.traverse import Capacity


class StepOptions(eqx.Module):
    """What a training step can be told."""

    loss: LossOptions
    optimizer: OptimizerOptions
    trace: TraceOptions


class Trial(eqx.Module):
    """Static sizes a block of steps is compiled for: list capacities and devices."""

    capacity: Capacity
    mesh: Mesh = eqx.field(static=True)

    def enlarged(self, needed) -> "Trial":
        """Room for lists of the sizes that a block turned out to need."""
        return Trial(enlarge(self.capacity, [int(n) for n in needed], headroom=1.5), self.mesh)


def first_trial(state: State, seen: Footage, batches, *, trace: TraceOptions, mesh: Mesh) -> Trial:
    """Sizes measured on the first step of a block, doubled: steps differ in what they look at."""

    @eqx.filter_jit
    def looked_at(parameters, seen, frame, tile, time):
        rays, _, _ = tile_rays(seen, frame, tile, side=trace.bundle)
        part = jax.tree.map(lambda x: x[: -(-x.shape[0] // mesh.size)], rays)
        return still(at(scene_of(parameters, jnp.zeros(2)), time)), part

    motion, rays = looked_at(state.parameters, seen, *(x[0] for x in batches))
    return Trial(measure(motion, rays, options=trace, headroom=2.0), mesh)


def loss_of(parameters: Parameters, seen: Footage, batch, *, options: StepOptions, trial: Trial):
    """Weighted sum of the terms of one step's loss, the terms, and what there is to report."""
    frame, tile, time = batch
    rays, truth, weight = tile_rays(seen, frame, tile, side=options.trace.bundle)
    scene = _dealt_out(scene_of(parameters, jnp.zeros(2)), trial.mesh)
    pixels, report = trace_sharded(
        still(at(scene, time)),
        rays,
        options=options.trace,
        capacity=trial.capacity,
        mesh=trial.mesh,
    )
    image = losses.developed(srgb_encode(pixels.color), truth)
    image = jnp.where(weight[:, None] > 0, image, truth)
    terms = losses.terms(image, truth, options=options.loss, side=options.trace.bundle)
    if parameters.deformation is not None:
        terms |= regularizer.terms(parameters.deformation.planes)
    total = sum(getattr(options.loss, name) * term for name, term in terms.items())
    terms["mse"] = jnp.mean((image - truth) ** 2)
    return total, (terms, report, rays.origin)


@eqx.filter_jit
def train_block(
    state: State, seen: Footage, batches, extent, *, options: StepOptions, steps: int, trial: Trial
):
    """The state after a block of steps, mean terms, largest list sizes, entries dropped.

    `batches` are frames and tiles (steps x tiles) and times (steps); `steps` is the length of the
    stage, over which the rates fall. If anything was dropped, the block is void: run it again with
    an enlarged trial.
    """

    def step(state: State, batch):
        slope = jax.value_and_grad(loss_of, has_aux=True)
        (_, (terms, report, eye)), gradient = slope(
            state.parameters, seen, batch, options=options, trial=trial
        )
        rate = rates(
            state.parameters, state.step, options=options.optimizer, extent=extent, steps=steps
        )
        static, moving = watch(state, gradient, eye)
        parameters, adam = descend(state.parameters, gradient, state.adam, rate)
        state = State(parameters, adam, static, moving, state.step + 1)
        return state, (terms, report.needed, report.dropped)

    state, (terms, needed, dropped) = jax.lax.scan(step, state, batches)
    found = state, jax.tree.map(jnp.mean, terms), jnp.max(needed, axis=0), jnp.sum(dropped)
    # Every host reads them.
    return jax.lax.with_sharding_constraint(found, NamedSharding(trial.mesh, PartitionSpec()))


def _dealt_out(scene: Scene, mesh: Mesh) -> Scene:
    """The moving Gaussians dealt out to the devices while they are deformed."""
    if mesh.size == 1 or scene.moving.count % mesh.size:
        return scene
    spread = NamedSharding(mesh, PartitionSpec("rays"))
    moving = jax.tree.map(lambda x: jax.lax.with_sharding_constraint(x, spread), scene.moving)
    return eqx.tree_at(lambda s: s.moving, scene, moving)
