"""The loss of a training step: its rays, the picture they see, the terms, and their sum."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float, Int

from gaussray.camera.array import CameraSet
from gaussray.camera.camera import Camera
from gaussray.camera.corrections import apply_color_response, refined_views
from gaussray.camera.rays import Rays
from gaussray.camera.sampling import step_samples
from gaussray.color import srgb_encode
from gaussray.reconstruct.block_sizes import BlockSizes
from gaussray.reconstruct.data.backdrop import BackdropColor, before_backdrop, like_backdrop
from gaussray.reconstruct.data.batches import Batch, tile_colors, tile_rays
from gaussray.reconstruct.optimize import loss as losses, regularizer, relocation
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.learning_rates import OptimizerOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.optimize.optimizer import Parameters, scene_of, transients_of
from gaussray.reconstruct.optimize.relocation import Presence
from gaussray.scene.scene import Scene
from gaussray.scene.transient import squared_age
from gaussray.tracer.composite import Pixels
from gaussray.tracer.motion import Motion, key_times_across, scene_motion
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.trace import Report
from gaussray.tracer.visible_subset import seen_part


class StepOptions(eqx.Module):
    """Options of a training step.

    Args:
        loss: weights of the terms of the loss.
        optimizer: learning rates.
        trace: how rays are traced.
        samples: rays of a pixel.
        footprint: the least standard deviation of a Gaussian, in pixels; 0: none.
        refine: what the stage refines of the cameras (`corrections.REFINABLE`).
        formed: whether static Gaussians were fitted in an earlier segment (`rates`).
        degree_interval: steps after which harmonics of the next degree begin to learn (`rates`).
        density: what opacity and scale cost, and the noise of positions.
        backdrop: sRGB-encoded colour of what is behind everything; None: the pictures show a room.
        silhouettes: whether nothing is where masks hide (`data.silhouettes`); there is no backdrop
            then.
        still: whether Gaussians that stand still are fitted to pictures in which things move: in
            the second half of the stage, pixels that differ much have no say.
        at_rest: whether control points began at rest: they learn at all times at once
            (`spread_over_time`), and hold on to their neighbours (`rigid_term`).
    """

    loss: LossOptions
    optimizer: OptimizerOptions
    trace: TraceOptions
    samples: int = eqx.field(static=True, default=1)
    footprint: float = eqx.field(static=True, default=0.0)
    refine: tuple[str, ...] = eqx.field(static=True, default=())
    formed: bool = eqx.field(static=True, default=False)
    degree_interval: int = eqx.field(static=True, default=0)
    density: DensityOptions = eqx.field(default_factory=DensityOptions)
    backdrop: BackdropColor | None = eqx.field(static=True, default=None)
    silhouettes: bool = eqx.field(static=True, default=False)
    still: bool = eqx.field(static=True, default=False)
    at_rest: bool = eqx.field(static=True, default=False)


class LossDetails(NamedTuple):
    """What a step reports beside the value of its loss.

    Args:
        terms: the terms of the loss, unweighted, by name, and `mse`, the mean squared error.
        report: the tracer's: list sizes needed and entries dropped.
        origin: origins of the rays, (samples x rays, 3).
        error: mean absolute difference of each tile.
    """

    terms: dict[str, Float[Array, ""]]
    report: Report
    origin: Float[Array, "origins 3"]
    error: Float[Array, " tiles"]


def loss_of(
    parameters: Parameters,
    views: Camera,
    batch: Batch,
    cameras: CameraSet,
    step: Int[Array, ""],
    *,
    options: StepOptions,
    sizes: BlockSizes,
    ignore_moving: Bool[Array, ""] | None = None,
) -> tuple[Float[Array, ""], LossDetails]:
    """The loss of one step: the sum of its terms, each times its weight.

    What opacity and scale cost is not part of it (`density_costs`).

    Args:
        parameters: what is learnt.
        views: the recorded cameras of all training frames, stacked.
        batch: the tiles of the step.
        cameras: the set of training cameras.
        step: steps of the stage before this one; it chooses the samples of pixels.
        options: the options of a step.
        sizes: what the step is compiled for.
        ignore_moving: whether pixels that differ much from the photograph's have no say, because
            they show what moves (`losses.far_apart`); None: all have.
    """
    batch = _tiles_dealt_out(batch, sizes.mesh)
    rays, gain = step_rays(parameters, views, batch, cameras, step, options)
    truth, weight = tile_colors(batch)
    scene = _dealt_out(scene_of(parameters, jnp.zeros(2), cameras.times), sizes.mesh)
    motion = step_motion(scene, rays, batch.time, cameras, sizes.keys)
    pixels, report = _traced(motion, rays, len(batch.tile), options, sizes)
    light = pixels.color
    if options.backdrop is not None:
        light = before_backdrop(light, pixels.transmittance, options.backdrop)
    light = light if rays.weight is None else rays.weight[..., None] * light
    color, through = jnp.mean(light, axis=0), jnp.mean(pixels.transmittance, axis=0)
    color = color if gain is None else apply_color_response(gain, color)
    # Pixels for which the lens forms no ray do not count.
    formed = jnp.all(jnp.any(rays.direction != 0, axis=-1), axis=0)
    hidden, weight = formed & (weight == 0), weight * formed

    def visible(light: Float[Array, "rays 3"]) -> Float[Array, "rays 3"]:
        developed = losses.developed(srgb_encode(light), truth)
        return jnp.where(weight[:, None] > 0, developed, truth)

    image = visible(color)
    judged = image
    if options.silhouettes:
        judged = visible(before_backdrop(color, through, _any_color(step)))
    if ignore_moving is not None:
        moved = losses.far_apart(image, truth, side=batch.side, bundle=options.trace.bundle)
        judged = jnp.where((ignore_moving & moved)[:, None], truth, judged)
    terms = losses.terms(
        judged, truth, options=options.loss, side=batch.side, bundle=options.trace.bundle
    )
    if options.loss.outside_opacity and options.silhouettes:
        terms["outside_opacity"] = jnp.mean(jnp.where(hidden, 1 - through, 0))
    if options.loss.backdrop_opacity and options.backdrop is not None:
        plain = (weight > 0) & like_backdrop(truth, options.backdrop)
        terms["backdrop_opacity"] = jnp.mean(jnp.where(plain, 1 - through, 0))
    if parameters.deformation is not None:
        terms |= regularizer.plane_terms(parameters.deformation.planes)
        control = parameters.deformation.control
        if options.at_rest and control is not None:
            terms["rigid"] = regularizer.rigid_term(control, batch.time)
    weights = options.loss.weights
    total = jnp.asarray(sum(weights[name] * term for name, term in terms.items()))
    terms["mse"] = jnp.sum((image - truth) ** 2) / (3 * jnp.maximum(jnp.sum(weight), 1))
    error = _tile_errors(image, truth, weight, batch)
    return total, LossDetails(terms, report, rays.origin.reshape(-1, 3), error)


def _any_color(step: Int[Array, ""]) -> Float[Array, "3"]:
    """Another colour behind everything in each step: a thing must be opaque to look the same before
    each of them."""
    return jax.random.uniform(jax.random.fold_in(jax.random.key(0), step), (3,))


def _traced(
    motion: Motion, rays: Rays, tiles: int, options: StepOptions, sizes: BlockSizes
) -> tuple[Pixels, Report]:
    """The pixels that the rays of a step see, and the tracer's report with what is `seen`."""
    trace = partial(
        trace_sharded,
        options=options.trace,
        capacity=sizes.capacity,
        mesh=sizes.mesh,
        presharded=tiles % sizes.mesh.size == 0,
    )
    if sizes.seen is None:
        return trace(motion, rays)
    part = seen_part(motion, rays, blocks=tiles, places=sizes.seen, options=options.trace)
    pixels, report = trace(part.motion, rays)
    missing = jnp.sum(jnp.maximum(part.needed - jnp.asarray(sizes.seen), 0), dtype=jnp.int32)
    needed = jnp.concatenate([report.needed, part.needed])
    return pixels, replace(report, needed=needed, dropped=report.dropped + missing)


def density_costs(
    parameters: Parameters, time: Array, cameras: CameraSet, density: DensityOptions
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """What opacity and scale cost where Gaussians are relocated, so that unused ones fade.

    Args:
        parameters: what is learnt.
        time: the step's time: transient Gaussians count as far as they are there.
        cameras: the set of training cameras, for extent and timestamps.
        density: kind of density control, and weights of the costs.

    Returns:
        The sum of both costs times their weights, and each without its weight (`relocation.costs`),
        by name; 0 and no names where Gaussians are not relocated.
    """
    if not density.relocates:
        return jnp.zeros(()), {}
    kinds = [Presence(free) for free in (parameters.static, parameters.moving)]
    if parameters.transient is not None:
        transient = transients_of(parameters.transient, cameras.times)
        age = squared_age(time - transient.instant, 1 / transient.lifetime, transient.plateau)
        window = jax.lax.stop_gradient(jnp.exp(-0.5 * age))
        kinds.append(Presence(parameters.transient, window, density.transient_cost))
    weights = {"opacity": density.opacity_cost, "scale": density.scale_cost}
    costs = relocation.costs(kinds, cameras.extent)
    total = sum((w * costs[name] for name, w in weights.items() if w), jnp.zeros(()))
    return total, {f"{name}_cost": costs[name] for name, w in weights.items() if w}


def step_rays(
    parameters: Parameters,
    views: Camera,
    batch: Batch,
    cameras: CameraSet,
    step: Int[Array, ""],
    options: StepOptions,
) -> tuple[Rays, Float[Array, "rays 3 ..."] | None]:
    """Rays of a step from the refined cameras, and the `color_response` for each pixel.

    Args:
        parameters: what is learnt, with the corrections of cameras.
        views: the recorded cameras of all training frames, stacked.
        batch: the tiles of the step.
        cameras: the set of training cameras.
        step: steps of the stage before this one; it chooses the samples of pixels.
        options: number of samples, and size of ray bundles.

    Returns:
        Rays (samples, tiles x pixels), and the responses (None: light as it is).
    """
    seen, owner = jax.tree.map(lambda x: x[batch.frame], (views, cameras.owner))
    camera, gain = refined_views(parameters.corrections, cameras, seen, owner)
    if gain is not None:
        gain = jnp.repeat(gain, batch.side**2, axis=0)
    u = step_samples(options.samples, step)
    return tile_rays(camera, batch.tile, u, side=batch.side, bundle=options.trace.bundle), gain


def step_motion(scene: Scene, rays: Rays, time: Array, cameras: CameraSet, keys: int) -> Motion:
    """The scene across the times of a step's rays, or at the step's own time for a single key.

    Args:
        scene: the scene.
        rays: the rays of the step.
        time: the step's time, the timestamp of its pictures.
        cameras: the set of training cameras, whose interval between timestamps is read.
        keys: the number of key states, evenly spread from the first to the last ray.
    """
    if keys == 1 or scene.deformation is None:
        return scene_motion(scene, time[None], held=True)
    first, last = jnp.min(rays.time), jnp.max(rays.time)
    key_time = key_times_across(first, last, keys, least=1e-3 * cameras.interval)
    return scene_motion(scene, jax.lax.stop_gradient(key_time), held=True)


def _tile_errors(image: Array, truth: Array, weight: Array, batch: Batch) -> Float[Array, " tiles"]:
    """Mean absolute difference over the visible pixels of every tile."""
    tiles = batch.tile.shape[0]
    difference = jnp.sum(jnp.abs(image - truth).reshape(tiles, -1), axis=1)
    return difference / (3 * jnp.maximum(jnp.sum(weight.reshape(tiles, -1), axis=1), 1))


def _tiles_dealt_out(batch: Batch, mesh: Mesh) -> Batch:
    """The tiles with as many on each device, which then computes their rays, pixels and loss."""
    if mesh.size == 1 or len(batch.tile) % mesh.size:
        return batch

    def spread(x: Array) -> Array:
        own = PartitionSpec("rays") if x.ndim else PartitionSpec()
        return jax.lax.with_sharding_constraint(x, NamedSharding(mesh, own))

    return jax.tree.map(spread, batch)


def _dealt_out(scene: Scene, mesh: Mesh) -> Scene:
    """The scene with its moving Gaussians sharded over the devices while they are deformed."""
    if mesh.size == 1 or scene.moving.count % mesh.size:
        return scene
    spread = NamedSharding(mesh, PartitionSpec("rays"))
    moving = jax.tree.map(lambda x: jax.lax.with_sharding_constraint(x, spread), scene.moving)
    return eqx.tree_at(lambda s: s.moving, scene, moving)
