"""One block of training steps, compiled: rays, loss, gradients, Adam, without the host."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.capture.batches import Batch, tile_colors, tile_rays
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


def first_trial(
    state: State, cameras: Camera, batches: Batch, *, trace: TraceOptions, mesh: Mesh
) -> Trial:
    """Sizes measured on the first step of a block, doubled: steps differ in what they look at."""

    @eqx.filter_jit
    def looked_at(parameters, cameras, batch):
        rays = tile_rays(cameras, batch.frame, batch.tile, side=trace.bundle)
        part = jax.tree.map(lambda x: x[: -(-x.shape[0] // mesh.size)], rays)
        return still(at(scene_of(parameters, jnp.zeros(2)), batch.time)), part

    motion, rays = looked_at(state.parameters, cameras, jax.tree.map(lambda x: x[0], batches))
    return Trial(measure(motion, rays, options=trace, headroom=2.0), mesh)


def loss_of(
    parameters: Parameters, cameras: Camera, batch: Batch, *, options: StepOptions, trial: Trial
):
    """Weighted sum of the terms of one step's loss, the terms, and what there is to report."""
    rays = tile_rays(cameras, batch.frame, batch.tile, side=options.trace.bundle)
    truth, weight = tile_colors(batch)
    scene = _dealt_out(scene_of(parameters, jnp.zeros(2)), trial.mesh)
    pixels, report = trace_sharded(
        still(at(scene, batch.time)),
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
    terms["mse"] = jnp.sum((image - truth) ** 2) / (3 * jnp.maximum(jnp.sum(weight), 1))
    return total, (terms, report, rays.origin, _tile_errors(image, truth, weight, batch))


@eqx.filter_jit
def train_block(
    state: State,
    cameras: Camera,
    batches: Batch,
    extent,
    *,
    options: StepOptions,
    steps: int,
    trial: Trial,
):
    """The state after a block of steps, mean terms, errors of all tiles, largest list sizes,
    entries dropped.

    `cameras` are those of all frames, `batches` what each step looks at; `steps` is the length of
    the stage, over which the rates fall. A tile's error is its mean absolute difference. If
    anything was dropped, the block is void: run it again with an enlarged trial.
    """

    def step(state: State, batch: Batch):
        slope = jax.value_and_grad(loss_of, has_aux=True)
        (_, (terms, report, eye, error)), gradient = slope(
            state.parameters, cameras, batch, options=options, trial=trial
        )
        rate = rates(
            state.parameters, state.step, options=options.optimizer, extent=extent, steps=steps
        )
        static, moving = watch(state, gradient, eye)
        parameters, adam = descend(state.parameters, gradient, state.adam, rate)
        state = State(parameters, adam, static, moving, state.step + 1)
        return state, (terms, error, report.needed, report.dropped)

    state, (terms, error, needed, dropped) = jax.lax.scan(step, state, batches)
    terms, needed = jax.tree.map(jnp.mean, terms), jnp.max(needed, axis=0)
    found = state, terms, error, needed, jnp.sum(dropped)
    # Every host reads them.
    return jax.lax.with_sharding_constraint(found, NamedSharding(trial.mesh, PartitionSpec()))


def _tile_errors(image: Array, truth: Array, weight: Array, batch: Batch) -> Float[Array, " tiles"]:
    """Mean absolute difference over the visible pixels of every tile."""
    tiles = batch.tile.shape[0]
    difference = jnp.sum(jnp.abs(image - truth).reshape(tiles, -1), axis=1)
    return difference / (3 * jnp.maximum(jnp.sum(weight.reshape(tiles, -1), axis=1), 1))


def _dealt_out(scene: Scene, mesh: Mesh) -> Scene:
    """The moving Gaussians dealt out to the devices while they are deformed."""
    if mesh.size == 1 or scene.moving.count % mesh.size:
        return scene
    spread = NamedSharding(mesh, PartitionSpec("rays"))
    moving = jax.tree.map(lambda x: jax.lax.with_sharding_constraint(x, spread), scene.moving)
    return eqx.tree_at(lambda s: s.moving, scene, moving)
