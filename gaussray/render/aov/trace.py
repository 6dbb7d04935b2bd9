"""Computes the labels of pixels from the surfaces that their rays meet."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from gaussray.camera.camera import Camera
from gaussray.camera.circle_of_confusion import circle_of_confusion
from gaussray.camera.rays import Rays
from gaussray.camera.rolling_projection import landing, place_at
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import normalize, safe_norm
from gaussray.render.compiled import ProgramSettings, prepare_trace
from gaussray.render.parts import Part
from gaussray.scene.normals import normals
from gaussray.scene.point_tracks import STATIC, carried, group_of
from gaussray.scene.scene import Scene
from gaussray.tracer.dominant import dominant
from gaussray.tracer.motion import Motion
from gaussray.tracer.trace import TraceOptions, trace
from gaussray.tracer.traverse import Capacity
from gaussray.tracer.vector_blend import blended, painted


# Labels of a surface, which are NaN where none is visible; labels that need the Gaussian with the
# largest weight; and labels of the ray itself, for which nothing is traced.
_SURFACE = ("depth", "z", "normal", "flow_forward", "flow_backward", "confusion", "blur")
_OF_DOMINANT = ("flow_forward", "flow_backward", "blur", "gaussian", "group", "moving")
OF_RAYS = ("time", "origin", "direction")
# Coverage from which a surface counts as visible.
COVERED = 0.5
# Pixels whose motion is computed at once.
_PIXELS = 1 << 16


class FrameCameras(eqx.Module):
    """The camera of a frame, and those of the frames before and after it, None if there is none."""

    camera: Camera
    before: Camera | None
    after: Camera | None


@eqx.filter_jit
def trace_labels(
    scene: Scene,
    cameras: FrameCameras,
    part: Part,
    pixel: Float[Array, "pixels 2"],
    *,
    settings: ProgramSettings,
    sizes: tuple[Capacity, Capacity],
    names: tuple[str, ...],
) -> tuple[dict[str, Array], list[tuple[Array, Array]]]:
    """The labels of these names for every pixel, and the list sizes that each trace needed, with
    the number of candidates that it dropped. `sizes` are the lists of the trace of surfaces and of
    the search for the Gaussian with the largest weight."""
    camera = cameras.camera
    motion, rays = prepare_trace(scene, camera, part, settings=settings)
    rays = jax.tree.map(lambda x: x[0], rays)
    chief: Rays = jax.tree.map(lambda x: x[part.slot], rays)
    labels: dict[str, Array] = {
        "time": chief.time,
        "origin": chief.origin,
        "direction": chief.direction,
    }
    reports: list[tuple[Array, Array]] = []
    if not set(names) <= set(OF_RAYS):
        seen, report = _surface(motion, rays, part, camera, settings.trace, sizes[0])
        labels |= seen
        reports.append(report)
        if set(names) & set(_OF_DOMINANT):
            best = dominant(
                motion, rays, options=replace(settings.trace, backend="array"), capacity=sizes[1]
            )
            reports.append((best.needed, best.dropped))
            index = best.index[part.slot]
            labels |= _identity(scene, index, seen["valid"])
        else:
            index = jnp.zeros(chief.time.shape, jnp.int32)
        tasks = _tasks(scene, cameras, names)
        pixel = pixel.astype(chief.time.dtype)
        pixels = pixel, chief, index, jnp.where(seen["valid"] > 0, seen["depth"], 1)

        def one(pixel: tuple) -> dict[str, Array]:
            return {name: task(*pixel) for name, task in tasks.items()}

        labels |= jax.lax.map(one, pixels, batch_size=min(_PIXELS, pixel.shape[0]))
        hidden = seen["valid"] == 0
        for name in set(_SURFACE) & set(labels):
            blank = hidden.reshape(-1, *(1,) * (labels[name].ndim - 1))
            labels[name] = jnp.where(blank, jnp.nan, labels[name])
    return {name: labels[name] for name in names}, reports


def _surface(
    motion: Motion, rays: Rays, part: Part, camera: Camera, options: TraceOptions, size: Capacity
) -> tuple[dict[str, Array], tuple[Array, Array]]:
    """Coverage, mean distance and mean normal of the surfaces that the rays meet, by one trace."""
    eye = pose_at(camera.trajectory, camera.time).translation
    facing = painted(motion, partial(normals, eye=eye), 1.0)
    pixels, report = trace(facing, rays, options=options, capacity=size)
    pixels = jax.tree.map(lambda x: x[part.slot], pixels)
    alpha = 1 - pixels.transmittance
    labels = {
        "alpha": alpha,
        "depth": pixels.depth / jnp.maximum(alpha, COVERED),
        "normal": normalize(blended(pixels, 1.0)),
        "valid": (alpha >= COVERED).astype(jnp.uint8),
    }
    return labels, (report.needed, report.dropped)


def _identity(scene: Scene, index: Int[Array, " n"], valid: Array) -> dict[str, Array]:
    """Gaussian, group and motion of every pixel; those of nothing where no surface is visible."""
    visible = (index >= 0) & (valid > 0)
    group = jnp.where(visible, group_of(scene)[jnp.maximum(index, 0)], 0)
    return {
        "gaussian": jnp.where(visible, index, -1),
        "group": group,
        "moving": (group > STATIC).astype(jnp.uint8),
    }


def _tasks(
    scene: Scene, cameras: FrameCameras, names: tuple[str, ...]
) -> dict[str, Callable[..., Array]]:
    """Labels that are computed pixel by pixel: functions of (pixel, ray, index, t).

    The visible point of a pixel is at its `depth` along the ray, and moves with the Gaussian of the
    largest weight. A mean over all Gaussians would mix the motions of foreground and background.
    Where nothing moves, flow depends on the depth alone.
    """
    camera = cameras.camera

    def path_of(ray: Rays, index: Array, t: Array) -> Callable[[Array], Array]:
        return carried(scene, index, ray.origin + t * ray.direction, ray.time)

    def flow(other: Camera | None) -> Callable[..., Array]:
        def towards(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
            if other is None:
                return jnp.full_like(pixel, jnp.nan)
            guess = other.time + (ray.time - camera.time)
            place, _, met = landing(other, path_of(ray, index, t), guess)
            return jnp.where(met, place - (pixel + 0.5), jnp.nan)

        return towards

    def blur(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
        path, half = path_of(ray, index, t), camera.shutter.exposure / 2
        moments = ray.time + half * jnp.asarray([-1, 1], t.dtype)
        ends = jax.vmap(lambda time: place_at(camera, path(time), time))(moments)
        return jnp.sum(safe_norm(ends - (pixel + 0.5)[None]))

    def z(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
        return t * camera.lens.direction(pixel + 0.5)[2]

    def confusion(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
        return circle_of_confusion(camera, pixel, t, ray.time)

    tasks: dict[str, Any] = {"z": z, "confusion": confusion, "blur": blur}
    tasks |= {"flow_forward": flow(cameras.after), "flow_backward": flow(cameras.before)}
    return {name: task for name, task in tasks.items() if name in names}
