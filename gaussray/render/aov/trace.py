"""What rays tell of the surfaces that they meet, pixel by pixel."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from gaussray.camera.camera import Camera
from gaussray.camera.circle_of_confusion import circle_of_confusion
from gaussray.camera.rays import Rays
from gaussray.camera.rolling_projection import landing, place_at
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import normalize, safe_norm
from gaussray.render.plan import Pace, Part
from gaussray.render.program import about_to_trace
from gaussray.scene.normals import normals
from gaussray.scene.point_tracks import STATIC, carried, group_of
from gaussray.scene.scene import Scene
from gaussray.tracer.dominant import dominant
from gaussray.tracer.motion import Motion
from gaussray.tracer.trace import TraceOptions, trace
from gaussray.tracer.traverse import Capacity
from gaussray.tracer.vector_blend import blended, painted


# Labels that are of a surface, and NaN where none is seen; those that ask for the Gaussian that
# adds most; and those that nothing has to be traced for.
_SURFACE = ("depth", "z", "normal", "flow_forward", "flow_backward", "confusion", "blur")
_OF_ONE = ("flow_forward", "flow_backward", "blur", "gaussian", "group", "moving")
OF_RAYS = ("time", "origin", "direction", "sharp")
# A surface is seen where it covers at least so much.
COVERED = 0.5
# Pixels whose motion is worked out at once.
_PIXELS = 1 << 16


@eqx.filter_jit
def labelled(
    scene: Scene,
    camera: Camera,
    before: Camera | None,
    after: Camera | None,
    part: Part,
    pixel: Array,
    *,
    pace: Pace,
    sizes: tuple[Capacity, Capacity],
    asked: tuple[str, ...],
) -> tuple[dict[str, Array], list[tuple[Array, Array]]]:
    """The labels asked for, pixel by pixel, and what list sizes each trace needed and dropped."""
    motion, rays = about_to_trace(scene, camera, part, pace=pace)
    rays = jax.tree.map(lambda x: x[0], rays)
    chief: Rays = jax.tree.map(lambda x: x[part.slot], rays)
    found: dict[str, Array] = {
        "time": chief.time,
        "origin": chief.origin,
        "direction": chief.direction,
    }
    reports: list[tuple[Array, Array]] = []
    if not set(asked) <= set(OF_RAYS):
        seen, report = _surface(motion, rays, part, camera, pace.trace, sizes[0])
        found |= seen
        reports.append(report)
        if set(asked) & set(_OF_ONE):
            best = dominant(
                motion, rays, options=replace(pace.trace, backend="array"), capacity=sizes[1]
            )
            reports.append((best.needed, best.dropped))
            index = best.index[part.slot]
            found |= _identity(scene, index, seen["valid"])
        else:
            index = jnp.zeros(chief.time.shape, jnp.int32)
        tasks = _tasks(scene, camera, before, after, asked)
        pixel = pixel.astype(chief.time.dtype)
        pixels = pixel, chief, index, jnp.where(seen["valid"] > 0, seen["depth"], 1)

        def one(pixel: tuple) -> dict[str, Array]:
            return {name: task(*pixel) for name, task in tasks.items()}

        found |= jax.lax.map(one, pixels, batch_size=min(_PIXELS, pixel.shape[0]))
        hidden = seen["valid"] == 0
        for name in set(_SURFACE) & set(found):
            blank = hidden.reshape(-1, *(1,) * (found[name].ndim - 1))
            found[name] = jnp.where(blank, jnp.nan, found[name])
    return {name: found[name] for name in asked}, reports


def _surface(
    motion: Motion, rays: Rays, part: Part, camera: Camera, options: TraceOptions, size: Capacity
) -> tuple[dict[str, Array], tuple[Array, Array]]:
    """What one trace tells: coverage, mean distance and mean normal of what the rays meet."""
    eye = pose_at(camera.trajectory, camera.time).translation
    facing = painted(motion, partial(normals, eye=eye), 1.0)
    pixels, report = trace(facing, rays, options=options, capacity=size)
    pixels = jax.tree.map(lambda x: x[part.slot], pixels)
    alpha = 1 - pixels.transmittance
    found = {
        "alpha": alpha,
        "depth": pixels.depth / jnp.maximum(alpha, COVERED),
        "normal": normalize(blended(pixels, 1.0)),
        "valid": (alpha >= COVERED).astype(jnp.uint8),
    }
    return found, (report.needed, report.dropped)


def _identity(scene: Scene, index: Int[Array, " n"], valid: Array) -> dict[str, Array]:
    """Whose the pixels are; nothing's where no surface is seen."""
    there = (index >= 0) & (valid > 0)
    group = jnp.where(there, group_of(scene)[jnp.maximum(index, 0)], 0)
    return {
        "gaussian": jnp.where(there, index, -1),
        "group": group,
        "moving": (group > STATIC).astype(jnp.uint8),
    }


def _tasks(
    scene: Scene,
    camera: Camera,
    before: Camera | None,
    after: Camera | None,
    asked: tuple[str, ...],
) -> dict[str, Callable[..., Array]]:
    """What is worked out pixel by pixel: functions of (pixel, ray, index, t).

    The point of a pixel is where its `depth` says, and moves with the Gaussian that adds most: a
    mean over all Gaussians would mix the motions of what is in front and what is behind, where
    either is solid. Where nothing moves, flow is that of the depth alone, whoever adds most.
    """

    def way(ray: Rays, index: Array, t: Array) -> Callable[[Array], Array]:
        return carried(scene, index, ray.origin + t * ray.direction, ray.time)

    def flow(other: Camera | None) -> Callable[..., Array]:
        def towards(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
            if other is None:
                return jnp.full_like(pixel, jnp.nan)
            guess = other.time + (ray.time - camera.time)
            place, _, met = landing(other, way(ray, index, t), guess)
            return jnp.where(met, place - (pixel + 0.5), jnp.nan)

        return towards

    def blur(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
        path, half = way(ray, index, t), camera.shutter.exposure / 2
        moments = ray.time + half * jnp.asarray([-1, 1], t.dtype)
        ends = jax.vmap(lambda time: place_at(camera, path(time), time))(moments)
        return jnp.sum(safe_norm(ends - (pixel + 0.5)[None]))

    def z(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
        return t * camera.lens.direction(pixel + 0.5)[2]

    def confusion(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
        return circle_of_confusion(camera, pixel, t, ray.time)

    tasks: dict[str, Any] = {"z": z, "confusion": confusion, "blur": blur}
    tasks |= {"flow_forward": flow(after), "flow_backward": flow(before)}
    return {name: task for name, task in tasks.items() if name in asked}
