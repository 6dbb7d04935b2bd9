"""The compiled program of a picture: rays, the scene at their times, the trace, the film."""

import dataclasses
import functools
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jax.tree_util import PyTreeDef
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.rays import Rays
from gaussray.render.camera_layout import CameraLayout
from gaussray.render.frame_times import frame_span, key_times
from gaussray.render.options import RenderOptions
from gaussray.render.parts import Part, samples_at_once
from gaussray.render.samples import sample_points, sample_rays
from gaussray.render.splat_compat import colors_from_center, dilate
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.scene import Scene
from gaussray.scene.transient import Transients, transients_at
from gaussray.tracer.composite import Pixels
from gaussray.tracer.motion import Motion, scene_motion
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.prepare import prepare
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.trace import Report, map_leading
from gaussray.tracer.traverse import Capacity


class ProgramSettings(eqx.Module):
    """Static settings of a program.

    Args:
        capacity: list sizes of the tracer.
        keys: number of key states; 0 is one, at the time of the part's row.
        options: how the picture is sampled.
        trace: options of the tracer.
        mesh: devices that share the rays; None is one device.
        quick: whether programs are compiled in half the time, and may run a tenth slower.
    """

    capacity: Capacity
    keys: int = eqx.field(static=True)
    options: RenderOptions
    trace: TraceOptions
    mesh: Mesh | None = eqx.field(static=True)
    quick: bool = eqx.field(static=True, default=True)


@functools.lru_cache(maxsize=64)
def render_part(
    structure: PyTreeDef, layout: CameraLayout, settings: ProgramSettings
) -> Callable[..., tuple[Array, Report]]:
    """The program of a part of a picture, whose rays are divided among the devices.

    It is cached, so that a frame costs the host little.

    Args:
        structure: structure of the scene.
        layout: layout of the camera's row of numbers.
        settings: static settings.

    Returns:
        A function of (leaves of the scene, row of the camera, part): red, green, blue, coverage and
        mean distance of the pixels; and a report.
    """

    @jax.jit
    def run(leaves: list[Array], row: Array, part: Part):
        scene, camera = jax.tree.unflatten(structure, leaves), layout.camera(row)
        u = sample_points(part, settings.options.samples)
        return part_values(scene, camera, u, part, settings)

    return run


@functools.lru_cache(maxsize=64)
def render_frames(
    structure: PyTreeDef, layout: CameraLayout, settings: ProgramSettings
) -> Callable[..., tuple[Array, Report]]:
    """`render_part` for several frames: each device renders the frame of one camera.

    Args:
        structure: structure of the scene.
        layout: layout of the camera's row of numbers; each device has a row.
        settings: static settings.
    """
    return _on_each(structure, layout, settings, of_each=("row",))


@functools.lru_cache(maxsize=64)
def render_pieces(
    structure: PyTreeDef, layout: CameraLayout, settings: ProgramSettings
) -> Callable[..., tuple[Array, Report]]:
    """`render_part` for one frame, of which each device renders a part (`parts.interleaved_parts`).

    No device waits for another, so that programs may share the devices.

    Args:
        structure: structure of the scene.
        layout: layout of the camera's row of numbers.
        settings: static settings.
    """
    return _on_each(structure, layout, settings, of_each=("part",))


def _on_each(
    structure: PyTreeDef, layout: CameraLayout, settings: ProgramSettings, of_each: tuple[str, ...]
):
    """Values and report of every device, stacked, where the arguments `of_each` have a row each."""
    if settings.mesh is None:
        raise ValueError("frames are spread over a mesh of devices, got none.")
    names, split = ("leaves", "row", "part"), PartitionSpec("rays")
    specs = tuple(split if name in of_each else PartitionSpec() for name in names)
    placed = [NamedSharding(settings.mesh, spec) for spec in specs]
    single = ProgramSettings(
        settings.capacity, settings.keys, settings.options, settings.trace, None
    )

    def one_device(*arguments):
        leaves, row, part = (
            jax.tree.map(lambda x: x[0], x) if name in of_each else x
            for name, x in zip(names, arguments, strict=True)
        )
        scene, camera = jax.tree.unflatten(structure, leaves), layout.camera(row)
        u = sample_points(part, settings.options.samples)
        values = part_values(scene, camera, u, part, single)
        return jax.tree.map(lambda x: x[None], values)

    return jax.jit(
        jax.shard_map(
            one_device, mesh=settings.mesh, in_specs=specs, out_specs=split, check_vma=False
        ),
        in_shardings=tuple(placed),
    )


def part_values(
    scene: Scene,
    camera: Camera,
    u: Float[Array, "samples 5"],
    part: Part,
    settings: ProgramSettings,
    key_time: Float[Array, " keys"] | None = None,
) -> tuple[Float[Array, "pixels 5"], Report]:
    """Red, green, blue, coverage and mean distance of a part of a picture, and the trace's report.

    Pure and differentiable in the scene, the camera and the key times.

    Args:
        scene: the scene.
        camera: the camera.
        u: the samples of every pixel (`camera.camera_ray`).
        part: the pixels.
        settings: list sizes, key states, options and devices.
        key_time: times of the key states of the scene; None spreads them over the frame's times.
    """
    if key_time is None:
        key_time = key_times(camera, part, settings.keys)
    motion = _motion(scene, camera, key_time, settings.options)
    if camera.chromatic is not None:

        def channel(magnification: Float[Array, ""]) -> tuple[tuple[Pixels, Array | None], Report]:
            return _trace_part(motion, camera, u, part, settings, magnification)

        traced, reports = map_leading(channel, camera.chromatic)
        report = merge_reports(reports)
    else:
        traced, report = _trace_part(motion, camera, u, part, settings)
        traced = jax.tree.map(lambda x: x[None], traced)
    return picture_values(*traced), report


def picture_values(
    pixels: Pixels, weight: Float[Array, "lenses pixels"] | None
) -> Float[Array, "pixels 5"]:
    """Red, green, blue, coverage and mean distance of pixels.

    Args:
        pixels: means of the samples, with a leading axis: one for all colours, or one for each.
        weight: mean weights of the rays, which have multiplied the samples; None is 1.
    """
    if weight is not None:
        pixels = _unweight(pixels, weight)
    color, transmittance, depth = pixels.color[0], pixels.transmittance[0], pixels.depth[0]
    if len(pixels.color) == 3:
        color = jnp.stack([pixels.color[i, :, i] for i in range(3)], axis=-1)
        transmittance, depth = (
            jnp.mean(pixels.transmittance, axis=0),
            jnp.mean(pixels.depth, axis=0),
        )
    alpha = 1 - transmittance
    depth = depth / jnp.maximum(alpha, 1e-6)
    return jnp.concatenate([color, alpha[:, None], depth[:, None]], axis=1)


def _trace_part(
    motion: Motion,
    camera: Camera,
    u: Float[Array, "samples 5"],
    part: Part,
    settings: ProgramSettings,
    magnification: Float[Array, ""] | None = None,
) -> tuple[tuple[Pixels, Array | None], Report]:
    """The part's pixels and the weights of their rays, each the mean of its samples;
    `magnification` is that of one colour."""
    shared = samples_at_once(settings.options, settings.trace)
    mask = None if part.share is None else part.share.mask
    # Once for all samples.
    span = frame_span(camera, part)
    scene = prepare(motion, span, options=settings.trace, capacity=settings.capacity)

    def trace_group(
        group: tuple[Array, Array | None],
    ) -> tuple[tuple[Pixels, Array | None], Report]:
        rays = sample_rays(camera, part.pixel, *group, magnification)
        pixels, report = trace_sharded(
            scene,
            rays,
            options=settings.trace,
            capacity=settings.capacity,
            mesh=settings.mesh,
        )
        weight = rays.weight
        if weight is not None:
            pixels = apply_weight(pixels, weight)
        return jax.tree.map(lambda x: jnp.mean(x, axis=0), (pixels, weight)), report

    groups = jax.tree.map(lambda x: x.reshape(-1, shared, x.shape[1]), (u, mask))
    means, reports = map_leading(trace_group, groups)
    means = jax.tree.map(lambda x: jnp.mean(x, axis=0)[part.slot], means)
    return means, merge_reports(reports)


def apply_weight(pixels: Pixels, weight: Float[Array, "*rays"]) -> Pixels:
    """Multiply traced rays by their weights.

    Args:
        pixels: traced rays.
        weight: weight of each ray.
    """
    return jax.tree.map(lambda x: x * _broadcast_weight(weight, x), pixels)


def _unweight(pixels: Pixels, weight: Array) -> Pixels:
    """Divide means of weight x value by the mean weight, except colours: lost light stays dark."""
    weighs = weight > 0
    whole = jnp.where(weighs, weight, 1)
    mean = jax.tree.map(lambda x: x / _broadcast_weight(whole, x), pixels)
    clear = jnp.where(weighs, mean.transmittance, 1)
    return dataclasses.replace(mean, color=pixels.color, transmittance=clear)


def _broadcast_weight(weight: Array, value: Array) -> Array:
    """Weights of rays beside what those see, which may have channels."""
    return weight.reshape(weight.shape + (1,) * (value.ndim - weight.ndim))


def merge_reports(reports: Report) -> Report:
    """Merge stacked reports into one."""
    return Report(
        needed=jnp.max(reports.needed, axis=0),
        dropped=jnp.sum(reports.dropped),
        skipped=jnp.max(reports.skipped),
        hits=jnp.sum(reports.hits),
    )


def _motion(
    scene: Scene, camera: Camera, key_time: Float[Array, " keys"], options: RenderOptions
) -> Motion:
    def as_rasterised(gaussians: Gaussians) -> Gaussians:
        if options.dilation:
            gaussians = dilate(gaussians, camera, options.dilation)
        if options.harmonics == "center":
            mean = gaussians.mean
            mean = mean if mean.ndim == 2 else mean[mean.shape[0] // 2]
            gaussians = colors_from_center(gaussians, camera, mean)
        return gaussians

    def rasterised_transients(transients: Transients) -> Transients:
        middle = as_rasterised(transients_at(transients, (key_time[0] + key_time[-1]) / 2))
        return dataclasses.replace(transients, scale=middle.scale, harmonics=middle.harmonics)

    motion = scene_motion(scene, key_time, scene.time_range)
    if not options.imitates_splatting:
        return motion
    rest, transient = motion.rest, motion.transient
    return dataclasses.replace(
        motion,
        gaussians=as_rasterised(motion.gaussians),
        rest=None if rest is None else as_rasterised(rest),
        transient=None if transient is None else rasterised_transients(transient),
    )


@eqx.filter_jit
def prepare_trace(
    scene: Scene, camera: Camera, part: Part, *, settings: ProgramSettings
) -> tuple[Motion, Rays]:
    """Motion and rays of the samples that are traced at once, for `measure`.

    Args:
        scene: the scene.
        camera: the camera.
        part: the pixels.
        settings: key states and options.
    """
    count = samples_at_once(settings.options, settings.trace)
    u = sample_points(part, settings.options.samples)
    motion = _motion(scene, camera, key_times(camera, part, settings.keys), settings.options)
    mask = None if part.share is None else part.share.mask[:count]
    return motion, sample_rays(camera, part.pixel, u[:count], mask)
