"""Photometric residuals of a camera estimate, and their derivatives by every unknown."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.calibrate.parameters import Unknown, corrected_camera
from gaussray.calibrate.pixel_blocks import PixelBlocks
from gaussray.camera.array import CameraSet
from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.rays import Rays
from gaussray.camera.sampling import sobol_samples
from gaussray.color import srgb_encode
from gaussray.geometry import product
from gaussray.reconstruct.optimize.loss import developed
from gaussray.scene.scene import Scene
from gaussray.tracer.measure import enlarged_capacity, measure
from gaussray.tracer.motion import Motion, scene_motion
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.traverse import Capacity


# Key states reach this share of the rays' time span beyond it: at the outermost key the derivative
# by time would be 0.
_MARGIN = 0.05


class CameraEstimate(eqx.Module):
    """A recorded camera and a value for each of its unknowns; zeros are the camera as recorded.

    Args:
        camera: the recorded camera.
        unit: its `parameters.unit_camera_set`.
        unknowns: the unknowns.
        value: their values.
    """

    camera: Camera
    unit: CameraSet
    unknowns: tuple[Unknown, ...]
    value: Float[Array, " unknowns"]

    def at(self, value: Float[Array, " unknowns"]) -> tuple[Camera, Float[Array, "3"]]:
        """The camera with these values of its unknowns, and its exposure gains."""
        return corrected_camera(value, self.camera, self.unit, self.unknowns)


class TraceSettings(eqx.Module):
    """How pictures are rendered.

    Args:
        samples: rays per pixel.
        keys: key states of the scene.
        trace: options of the tracer.
    """

    samples: int = eqx.field(static=True)
    keys: int = eqx.field(static=True)
    trace: TraceOptions


class NormalEquations(eqx.Module):
    """Residuals of pixel blocks, and the sums of robust least squares over them.

    Args:
        residual: rendered minus recorded sRGB value; 0 where a block does not count.
        counts: 1 where a block counts, else 0.
        gradient: gradient of Huber's loss.
        curvature: weighted Gauss-Newton Hessian, for steps.
        inlier_curvature: Gauss-Newton Hessian of the residuals below the bend, for standard errors.
        scatter: sums of g g^T over blocks and over ray tiles; g is the gradient of one of them.
    """

    residual: Float[Array, "blocks 3"]
    counts: Float[Array, " blocks"]
    gradient: Float[Array, " unknowns"]
    curvature: Float[Array, "unknowns unknowns"]
    inlier_curvature: Float[Array, "unknowns unknowns"]
    scatter: Float[Array, "2 unknowns unknowns"]


class ResidualEvaluator:
    """Compares camera estimates with pictures; keeps the list capacities that the tracer needs.

    Args:
        samples: rays per pixel.
        trace: options of the tracer.
        bend: where Huber's loss turns linear, in standard deviations.
    """

    def __init__(self, *, samples: int, trace: TraceOptions, bend: float):
        self.samples, self.bend = samples, bend
        # Ray tiles of a group need not be neighbours, so there are no coarser bundles.
        self.trace = dataclasses.replace(trace, levels=0)
        self._capacity: dict[tuple[int, int], Capacity] = {}

    def __call__(
        self,
        scene: Scene,
        estimate: CameraEstimate,
        blocks: PixelBlocks,
        deviation: float,
        *,
        keys: int,
    ) -> NormalEquations:
        """Residuals of the blocks for a camera estimate, and their normal equations.

        Args:
            scene: the scene.
            estimate: the camera estimate.
            blocks: the blocks.
            deviation: standard deviation of the residuals, the unit of the bend.
            keys: number of key states of the scene.
        """
        settings = TraceSettings(self.samples, keys, self.trace)
        inputs = scene, estimate, blocks, settings
        size = blocks.weight.shape[0], keys
        if size not in self._capacity:
            self._capacity[size] = measure(*_scene_and_rays(*inputs), options=self.trace)
        while True:
            capacity = self._capacity[size]
            colors, needed, dropped = _color_slopes(*inputs, capacity)
            if not int(dropped):
                break
            self._capacity[size] = enlarged_capacity(capacity, [int(n) for n in needed])
        bend = jnp.asarray(self.bend * deviation, estimate.value.dtype)
        equations = _normal_equations(colors, estimate, blocks, bend, self.trace.bundle)
        return jax.device_get(equations)


class ColorSlopes(eqx.Module):
    """Linear colours of rays, their derivatives by the unknowns, and the rays' weights."""

    color: Float[Array, "rays 3"]
    slope: Float[Array, "rays 3 unknowns"]
    weight: Float[Array, " rays"]


def _rays(
    estimate: CameraEstimate, value: Array, blocks: PixelBlocks, settings: TraceSettings
) -> Rays:
    """Rays of all samples; a ray without weight has no direction and meets nothing."""
    camera, _ = estimate.at(value)
    pixel, weight = blocks.pixel, blocks.weight
    u = sobol_samples(settings.samples).astype(value.dtype)

    def sample(one: Float[Array, "5"]) -> Rays:
        return camera_rays(camera, pixel, jnp.broadcast_to(one, (pixel.shape[0], 5)))

    rays = jax.vmap(sample)(u)
    direction = jnp.where(weight[None, :, None] > 0, rays.direction, 0)
    return dataclasses.replace(rays, direction=direction, weight=None)


def _motion(scene: Scene, rays: Rays, keys: int) -> Motion:
    """Key states of the scene across the times of the rays, and a little beyond."""
    if scene.deformation is None:
        return scene_motion(scene, jnp.zeros_like(rays.time[0, :1]), scene.time_range)
    time = jax.lax.stop_gradient(rays.time)
    first, last = jnp.min(time), jnp.max(time)
    instants = jnp.asarray(scene.deformation.instants, time.dtype)
    least = (instants[-1] - instants[0]) / max(4 * (len(instants) - 1), 1)
    room = jnp.maximum(_MARGIN * (last - first), jnp.where(last > first, 0, least))
    key_time = jnp.linspace(first - room, last + room, max(keys, 3), dtype=time.dtype)
    return scene_motion(scene, key_time, scene.time_range)


@eqx.filter_jit
def _scene_and_rays(
    scene: Scene, estimate: CameraEstimate, blocks: PixelBlocks, settings: TraceSettings
) -> tuple[Motion, Rays]:
    """What is traced: the moving scene and the rays, for measuring capacities."""
    rays = _rays(estimate, estimate.value, blocks, settings)
    return _motion(scene, rays, settings.keys), rays


@eqx.filter_jit
def _color_slopes(
    scene: Scene,
    estimate: CameraEstimate,
    blocks: PixelBlocks,
    settings: TraceSettings,
    capacity: Capacity,
) -> tuple[ColorSlopes, Array, Array]:
    """Colours of the rays and their derivatives, list sizes, and the number of dropped entries.

    A ray's colour depends on that ray alone. So three backward passes, one per channel, give the
    slope of every colour by the ray's own origin, direction and time; the slopes of these by the
    unknowns come from forward mode. The cost hardly depends on the number of unknowns.
    """

    def rays_of(value: Array) -> Rays:
        return _rays(estimate, value, blocks, settings)

    rays, ray_slope = rays_of(estimate.value), jax.jacfwd(rays_of)(estimate.value)
    motion = _motion(scene, rays, settings.keys)

    def color_of(rays: Rays):
        options = settings.trace
        pixels, report = trace_sharded(motion, rays, options=options, capacity=capacity, mesh=None)
        return pixels.color, report

    color, pull, report = jax.vjp(color_of, rays, has_aux=True)
    channels = jnp.broadcast_to(jnp.eye(3, dtype=color.dtype)[:, None, None], (3, *color.shape))
    slope = jax.lax.map(lambda one: pull(one)[0], channels)
    by_unknown = (
        product("csrx,srxp->rcp", slope.origin, ray_slope.origin)
        + product("csrx,srxp->rcp", slope.direction, ray_slope.direction)
        + product("csr,srp->rcp", slope.time, ray_slope.time)
    ) / color.shape[0]
    formed = jnp.all(jnp.any(rays.direction != 0, axis=-1), axis=0)
    weight = jnp.where(formed, blocks.weight, 0)
    colors = ColorSlopes(jnp.mean(color, axis=0), by_unknown, weight)
    return colors, report.needed, report.dropped


@eqx.filter_jit
def _normal_equations(
    colors: ColorSlopes, estimate: CameraEstimate, blocks: PixelBlocks, bend: Array, bundle: int
) -> NormalEquations:
    """Sums over all blocks, from sRGB-encoded mean colours."""

    def gain_of(value: Array) -> Array:
        return estimate.at(value)[1]

    color, slope, counts = _block_colors(colors, blocks.side, bundle)
    gain, gain_slope = gain_of(estimate.value), jax.jacfwd(gain_of)(estimate.value)
    slope = gain[None, :, None] * slope + color[..., None] * gain_slope[None]
    light = gain[None] * color
    encoded, encoding_slope = jax.jvp(
        lambda x: developed(srgb_encode(x), blocks.truth), (light,), (jnp.ones_like(light),)
    )
    has_rays = counts[:, None] > 0
    residual = jnp.where(has_rays, encoded - blocks.truth, 0)
    slope = jnp.where(has_rays[..., None], encoding_slope[..., None] * slope, 0)
    size = jnp.abs(residual)
    inlier = (size < bend).astype(size.dtype)
    weight = jnp.where(size < bend, 1, bend / jnp.where(size < bend, 1, size))
    of_block = product("bcp,bc->bp", slope, weight * residual)
    of_tile = jnp.sum(of_block.reshape(-1, (bundle // blocks.side) ** 2, of_block.shape[1]), axis=1)
    return NormalEquations(
        residual,
        counts,
        jnp.sum(of_block, axis=0),
        product("bcp,bc,bcq->pq", slope, weight, slope),
        product("bcp,bc,bcq->pq", slope, inlier, slope),
        jnp.stack([product("bp,bq->pq", x, x) for x in (of_block, of_tile)]),
    )


def _block_colors(colors: ColorSlopes, side: int, bundle: int) -> tuple[Array, Array, Array]:
    """Weighted means of colours and slopes over each block of side x side rays, and 1 for each
    block that has a ray with weight."""
    each, weight = bundle // side, colors.weight
    shape = -1, each, side, each, side

    def summed(x: Array) -> Array:
        blocks = jnp.sum(x.reshape(*shape, *x.shape[1:]), axis=(2, 4))
        return blocks.reshape(-1, *x.shape[1:])

    count = summed(weight)
    total = jnp.where(count > 0, count, 1)
    color = summed(weight[:, None] * colors.color) / total[:, None]
    slope = summed(weight[:, None, None] * colors.slope) / total[:, None, None]
    return color, slope, (count > 0).astype(weight.dtype)
