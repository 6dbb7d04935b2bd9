"""A block of training steps in one compiled program: rays, loss, gradients, Adam."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int

from gaussray.camera.array import CameraSet, resolved
from gaussray.camera.camera import Camera
from gaussray.camera.corrections import refined_views
from gaussray.camera.rays import Rays
from gaussray.camera.sampling import step_samples
from gaussray.color import srgb_encode
from gaussray.reconstruct.data.batches import Batch, tile_colors, tile_rays
from gaussray.reconstruct.optimize import loss as losses, regularizer, relocation
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.optimize.optimizer import (
    OptimizerOptions,
    Parameters,
    descend,
    rates,
    scene_of,
)
from gaussray.reconstruct.optimize.state import State, accumulated_statistics
from gaussray.scene.gaussians import Unconstrained
from gaussray.scene.scene import Scene
from gaussray.tracer.motion import Motion, scene_motion
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.trace import TraceOptions, enlarged_capacity, measure
from gaussray.tracer.traverse import Capacity


# Logarithm of how much flatter than wide a Gaussian of least size may be.
FLAT = 1.1


class StepOptions(eqx.Module):
    """Options of a training step.

    `samples` is the number of rays of a pixel, `footprint` the least standard deviation of a
    Gaussian in pixels, `refine` what the stage refines of the cameras. `formed` and `rise` (the
    steps after which harmonics of the next degree begin to learn) are those of `rates`.
    """

    loss: LossOptions
    optimizer: OptimizerOptions
    trace: TraceOptions
    samples: int = eqx.field(static=True, default=1)
    footprint: float = eqx.field(static=True, default=0.0)
    refine: tuple[str, ...] = eqx.field(static=True, default=())
    formed: bool = eqx.field(static=True, default=False)
    rise: int = eqx.field(static=True, default=0)
    density: DensityOptions = eqx.field(default_factory=DensityOptions)


class Schedule(eqx.Module):
    """Length of a stage in steps, over which the rates fall, and the seed of the steps' noise.

    Arrays, so that other values compile nothing.
    """

    steps: Int[Array, ""]
    seed: Int[Array, ""]


def schedule(steps: int, seed: int) -> Schedule:
    """The schedule of a stage."""
    return Schedule(jnp.asarray(steps, jnp.int32), jnp.asarray(seed, jnp.int32))


class BlockSizes(eqx.Module):
    """The static sizes that a block of steps is compiled for: the capacity of the tracer's lists,
    the devices, and the number of key states of the scene across a step (1: all its rays share one
    time)."""

    capacity: Capacity
    mesh: Mesh = eqx.field(static=True)
    keys: int = eqx.field(static=True, default=1)

    def enlarged(self, needed) -> "BlockSizes":
        """Sizes for a block whose lists needed this much room."""
        capacity = enlarged_capacity(self.capacity, [int(n) for n in needed], headroom=1.5)
        return BlockSizes(capacity, self.mesh, self.keys)


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
    """Twice the sizes that the first step of a block needs: steps see different tiles. `growth` is
    the factor by which the lists are expected to grow."""

    @eqx.filter_jit
    def first_step(state, views, batch, cameras):
        rays, _ = _rays(state.parameters, views, batch, cameras, state.step, options)
        scene = scene_of(state.parameters, jnp.zeros(2))
        part = jax.tree.map(lambda x: x[:, : -(-x.shape[1] // mesh.size)], rays)
        return _motion(scene, rays, batch.time, cameras, keys), part

    motion, rays = first_step(state, views, jax.tree.map(lambda x: x[0], batches), cameras)
    return BlockSizes(
        measure(motion, rays, options=options.trace, headroom=2.0 * growth), mesh, keys
    )


def loss_of(
    parameters: Parameters,
    views: Camera,
    batch: Batch,
    cameras: CameraSet,
    step: Int[Array, ""],
    *,
    options: StepOptions,
    sizes: BlockSizes,
):
    """The loss of one step (the weighted sum of its terms), and the terms, the tracer's report, the
    origins of the rays and the errors of the tiles."""
    rays, gain = _rays(parameters, views, batch, cameras, step, options)
    truth, weight = tile_colors(batch)
    scene = _dealt_out(scene_of(parameters, jnp.zeros(2)), sizes.mesh)
    pixels, report = trace_sharded(
        _motion(scene, rays, batch.time, cameras, sizes.keys),
        rays,
        options=options.trace,
        capacity=sizes.capacity,
        mesh=sizes.mesh,
    )
    light = pixels.color if rays.weight is None else rays.weight[..., None] * pixels.color
    color = jnp.mean(light, axis=0)
    image = losses.developed(srgb_encode(color if gain is None else gain * color), truth)
    # Pixels for which the lens forms no ray do not count.
    weight = weight * jnp.all(jnp.any(rays.direction != 0, axis=-1), axis=0)
    image = jnp.where(weight[:, None] > 0, image, truth)
    terms = losses.terms(
        image, truth, options=options.loss, side=batch.side, bundle=options.trace.bundle
    )
    if parameters.deformation is not None:
        terms |= regularizer.plane_terms(parameters.deformation.planes)
    total = sum(getattr(options.loss, name) * term for name, term in terms.items())
    total += _density_cost(parameters, cameras, options.density)
    terms["mse"] = jnp.sum((image - truth) ** 2) / (3 * jnp.maximum(jnp.sum(weight), 1))
    error = _tile_errors(image, truth, weight, batch)
    return total, (terms, report, rays.origin.reshape(-1, 3), error)


def _density_cost(
    parameters: Parameters, cameras: CameraSet, density: DensityOptions
) -> Float[Array, ""] | float:
    """What the loss adds for opacity and scale where Gaussians are relocated: unused ones fade."""
    total = 0.0
    if density.relocates:
        for free in _both(parameters):
            mean = relocation.costs(free, cameras.extent)
            total += density.opacity_cost * mean["opacity"] + density.scale_cost * mean["scale"]
    return total


def _explored(
    parameters: Parameters,
    cameras: CameraSet,
    schedule: Schedule,
    step: Int[Array, ""],
    options: StepOptions,
) -> Parameters:
    """Noise on the positions of faint Gaussians, if they are relocated."""
    density = options.density
    if not density.relocates or not density.noise:
        return parameters
    fall = options.optimizer.decay ** (step / jnp.maximum(schedule.steps, 1))
    key = jax.random.fold_in(jax.random.key(schedule.seed), step)
    moved = [
        relocation.explore(free, own, size=density.noise * fall, extent=cameras.extent)
        for own, free in zip(jax.random.split(key), _both(parameters), strict=True)
    ]
    return eqx.tree_at(_both, parameters, tuple(moved))


def _rays(
    parameters: Parameters,
    views: Camera,
    batch: Batch,
    cameras: CameraSet,
    step: Int[Array, ""],
    options: StepOptions,
) -> tuple[Rays, Float[Array, "rays 3"] | None]:
    """Rays of a step (samples x rays) from the refined cameras, and the exposure gain of each
    pixel (None: 1)."""
    seen, owner = jax.tree.map(lambda x: x[batch.frame], (views, cameras.owner))
    camera, gain = refined_views(parameters.corrections, cameras, seen, owner)
    if gain is not None:
        gain = jnp.repeat(gain, batch.side**2, axis=0)
    u = step_samples(options.samples, step)
    return tile_rays(camera, batch.tile, u, side=batch.side, bundle=options.trace.bundle), gain


def _motion(scene: Scene, rays: Rays, time: Array, cameras: CameraSet, keys: int) -> Motion:
    """The scene across the times of a step's rays, or at the step's own time for a single key."""
    if keys == 1 or scene.deformation is None:
        return scene_motion(scene, time[None])
    # Rays that happen to share one time still need an interval to be in.
    first = jnp.min(rays.time)
    last = jnp.maximum(jnp.max(rays.time), first + 1e-3 * cameras.interval)
    key_time = jax.lax.stop_gradient(jnp.linspace(first, last, keys, dtype=first.dtype))
    return scene_motion(scene, key_time)


@eqx.filter_jit
def train_block(
    state: State,
    views: Camera,
    batches: Batch,
    cameras: CameraSet,
    *,
    options: StepOptions,
    schedule: Schedule,
    sizes: BlockSizes,
):
    """The state after a block of steps, the mean terms of the loss, the errors of all tiles, the
    largest list sizes, and how many list entries were dropped.

    `views` are the cameras of all frames as recorded, `batches` what each step looks at; over the
    steps of the `schedule` the rates fall. A tile's error is its mean absolute
    difference. If anything was dropped, the block is void: run it again with enlarged sizes.
    """

    shortest = _shortest(state.parameters, cameras, options.footprint)

    def step(state: State, batch: Batch):
        slope = jax.value_and_grad(loss_of, has_aux=True)
        (_, (terms, report, eye, error)), gradient = slope(
            state.parameters, views, batch, cameras, state.step, options=options, sizes=sizes
        )
        rate = rates(
            state.parameters,
            state.step,
            options=options.optimizer,
            extent=cameras.extent,
            steps=schedule.steps,
            refine=options.refine,
            formed=options.formed,
            rise=options.rise,
        )
        static, moving = accumulated_statistics(state, gradient, eye)
        parameters, adam = descend(state.parameters, gradient, state.adam, rate)
        parameters = _explored(parameters, cameras, schedule, state.step, options)
        parameters = _widened(parameters, shortest)
        state = State(parameters, adam, static, moving, state.step + 1)
        return state, (terms, error, report.needed, report.dropped)

    state, (terms, error, needed, dropped) = jax.lax.scan(step, state, batches)
    terms, needed = jax.tree.map(jnp.mean, terms), jnp.max(needed, axis=0)
    result = state, terms, error, needed, jnp.sum(dropped)
    # Every host reads the result.
    return jax.lax.with_sharding_constraint(result, NamedSharding(sizes.mesh, PartitionSpec()))


def _shortest(
    parameters: Parameters, cameras: CameraSet, footprint: float
) -> tuple[Float[Array, " static"], Float[Array, " moving"]] | None:
    """Logarithm of the least scale of static and of moving Gaussians; None if there is no bound.

    A Gaussian smaller than the pixels is met by some of the rays that should see it and missed by
    others: it fits single training pixels and aliases in all other pictures. This is the 3D
    smoothing filter of Mip-Splatting, as a bound. It is computed once per block, for distances to
    the cameras hardly change within one.
    """
    if not footprint:
        return None
    static, moving = (
        jnp.log(footprint * resolved(cameras, free.mean) + 1e-30)
        for free in (parameters.static, parameters.moving)
    )
    return static, moving


def _widened(parameters: Parameters, shortest) -> Parameters:
    """The parameters with scales of at least these; a third of them along the shortest axis."""
    if shortest is None:
        return parameters

    def wide(scale: Float[Array, "gaussians 3"], least: Array) -> Float[Array, "gaussians 3"]:
        flat = scale <= jnp.min(scale, axis=1, keepdims=True)
        return jnp.maximum(scale, jnp.where(flat, least[:, None] - FLAT, least[:, None]))

    scales = [
        wide(free.log_scale, least) for free, least in zip(_both(parameters), shortest, strict=True)
    ]
    return eqx.tree_at(lambda p: [free.log_scale for free in _both(p)], parameters, scales)


def _both(parameters: Parameters) -> tuple[Unconstrained, Unconstrained]:
    return parameters.static, parameters.moving


def _tile_errors(image: Array, truth: Array, weight: Array, batch: Batch) -> Float[Array, " tiles"]:
    """Mean absolute difference over the visible pixels of every tile."""
    tiles = batch.tile.shape[0]
    difference = jnp.sum(jnp.abs(image - truth).reshape(tiles, -1), axis=1)
    return difference / (3 * jnp.maximum(jnp.sum(weight.reshape(tiles, -1), axis=1), 1))


def _dealt_out(scene: Scene, mesh: Mesh) -> Scene:
    """The scene with its moving Gaussians sharded over the devices while they are deformed."""
    if mesh.size == 1 or scene.moving.count % mesh.size:
        return scene
    spread = NamedSharding(mesh, PartitionSpec("rays"))
    moving = jax.tree.map(lambda x: jax.lax.with_sharding_constraint(x, spread), scene.moving)
    return eqx.tree_at(lambda s: s.moving, scene, moving)
