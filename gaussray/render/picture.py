"""A picture as a pure function of scene and camera, differentiable in everything continuous."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from gaussray.camera.camera import Camera, check_camera
from gaussray.camera.rays import Rays
from gaussray.camera.sampling import random_samples, sobol_samples
from gaussray.geometry import normalize
from gaussray.io.plain_values import readable
from gaussray.io.validate import check_kind
from gaussray.render.compiled import ProgramSettings, part_values
from gaussray.render.frame_times import frame_span
from gaussray.render.options import RenderOptions
from gaussray.render.parts import strip_tops
from gaussray.render.plan import (
    NumbersNeeded,
    Plan,
    PlanCache,
    check_renderable,
    flat_rays,
    picture_key_times,
    picture_motion,
    plan as measured_plan,
    plan_key,
    shift_part,
)
from gaussray.scene.scene import Scene
from gaussray.tracer.bundle import coherent_order
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.prepare import time_span
from gaussray.tracer.trace import trace as trace_rays


class Picture(eqx.Module):
    """A picture: the values of pixels or rays.

    Args:
        color: linear light; 1 is white.
        alpha: coverage, 1 - transmittance.
        depth: mean distance along the ray of what is seen, in scene units.
        dropped: list entries that were dropped, and key states that were missing: 0 if the picture
            is complete. Otherwise the plan was too small: use `plan.enlarged(picture.needed)`.
        needed: list sizes that the picture needs, in the order of `Capacity`, and its number of key
            states (`RenderOptions.keys`).
    """

    color: Float[Array, "*pixels 3"]
    alpha: Float[Array, "*pixels"]
    depth: Float[Array, "*pixels"]
    dropped: Int[Array, ""]
    needed: Int[Array, " sizes"]

    def __repr__(self) -> str:
        return readable(self)


def render(
    scene: Scene,
    camera: Camera,
    *,
    key: Array | None = None,
    options: RenderOptions | None = None,
    trace: TraceOptions | None = None,
    plan: Plan | None = None,
) -> Picture:
    """Render the picture that a camera takes of a scene.

    A pure function for `jit`, `grad` and `vmap`, differentiable in Gaussians, deformation, lens,
    pose, aperture, focus, shutter and times. Without a plan it measures list sizes when it is
    called with numbers (also inside `grad` alone) and caches them. Inside `jit` and `vmap` it uses
    the cached sizes of arguments of the same shapes, or the `plan`.

    The derivative is that of the picture with the hits of every ray and their order held fixed.
    It leaves out what a change of the order itself adds: where the centres of two overlapping
    Gaussians change places along a ray, colour jumps by about alpha_1 alpha_2 (c_1 - c_2) times
    the transmittance in front, and a finite difference of the whole picture counts these jumps.
    In a scene of many large opaque Gaussians that may be half of the derivative by the focal
    length; where surfaces are thin it is little. With the order held fixed, finite differences
    agree to rounding (`tests/render/test_picture.py`).

    Args:
        scene: the scene; of a clip, one of its segments.
        camera: the camera.
        key: a `jax.random` key, which shifts the samples of all pixels by a random vector; None
            uses the same well-spread samples each time.
        options: how the picture is sampled; default `RenderOptions()`, 4 rays a pixel.
        trace: how rays are traced; default `TraceOptions()`.
        plan: sizes from `gaussray.plan`, which then holds options and trace.

    Returns:
        The picture, height x width, in linear light.

    Raises:
        ValueError: An argument is of another type, sizes are unknown inside `jit` or `vmap`,
            options are given beside a plan, the scene is a clip, the options need `Renderer`, or
            the parts of the camera do not go together (`check_camera`).
    """
    check_kind("camera", camera, Camera, "a gaussray.Camera")
    _check_key(key)
    if plan is not None:
        _check_plan(scene, plan, options, trace)
        if plan.rows == 0:
            raise ValueError("plan must be of a camera, got one of rays: gaussray.plan(..., rays).")
        return _camera_picture(scene, camera, key, plan)
    check_camera(camera)
    return _with_plan(_camera_picture, scene, camera, key, options, trace)


def render_rays(
    scene: Scene,
    rays: Rays,
    *,
    trace: TraceOptions | None = None,
    plan: Plan | None = None,
) -> Picture:
    """Render rays, each at its own time; pure and differentiable like `render`.

    Args:
        scene: the scene; of a clip, one of its segments.
        rays: rays of any shape: origins, directions and times. Directions count as unit vectors
            whatever their length; one of zero sees nothing. A weight multiplies colour.
        trace: how rays are traced; default `TraceOptions()`.
        plan: sizes from `gaussray.plan(scene, rays)`.

    Returns:
        Colour, coverage and distance in the shape of the rays.

    Raises:
        ValueError: As for `render`.
    """
    check_kind("rays", rays, Rays, "gaussray.Rays")
    rays = dataclasses.replace(rays, direction=_unit(rays.direction))
    if plan is not None:
        _check_plan(scene, plan, None, trace)
        return _ray_picture(scene, rays, None, plan)
    return _with_plan(_ray_picture, scene, rays, None, None, trace)


_unit = jax.jit(normalize)
_plans = PlanCache()


def _with_plan(draw, scene, camera, key, options, trace) -> Picture:
    """A picture with list sizes and key states that are enough, if the arguments are numbers;
    otherwise with those of the last picture of such arguments."""
    options = RenderOptions() if options is None else options
    trace = TraceOptions() if trace is None else trace
    check_kind("trace", trace, TraceOptions, "gaussray.TraceOptions(...)")
    check_renderable(scene, options)
    shapes = plan_key(scene, camera, options, trace)
    plan = _plans.get(shapes)
    try:
        if plan is None:
            plan = measured_plan(scene, camera, options=options, trace=trace)
    except NumbersNeeded as error:
        raise NumbersNeeded(
            f"{error} Give the plan to the picture, gaussray.render(..., plan=plan), or render one "
            "of numbers before."
        ) from None
    while True:
        picture = draw(scene, camera, key, plan)
        try:
            short = int(picture.dropped) > 0
        except jax.errors.ConcretizationTypeError:
            return picture
        if not short:
            _plans.put(shapes, plan)
            return picture
        plan = plan.enlarged(jax.lax.stop_gradient(picture.needed))


def _check_key(key: Any) -> None:
    """Refuse what is neither None nor one key of `jax.random`, new or old (2 or 4 numbers)."""
    if key is None:
        return
    dtype, axes = getattr(key, "dtype", None), len(getattr(key, "shape", ()))
    new = dtype is not None and jnp.issubdtype(dtype, jax.dtypes.prng_key) and axes == 0
    if not new and not (dtype == jnp.uint32 and axes == 1):
        raise ValueError(f"key must be one key, such as jax.random.key(3), or None, got {key!r}.")


def _check_plan(
    scene: Scene, plan: Plan, options: RenderOptions | None, trace: TraceOptions | None
) -> None:
    check_kind("plan", plan, Plan, "a gaussray.Plan, which gaussray.plan(scene, camera) makes")
    check_renderable(scene, plan.options)
    for name, value in (("options", options), ("trace", trace)):
        if value is not None and value != getattr(plan, name):
            raise ValueError(f"{name} must be left out beside a plan, which was made for its own.")


@eqx.filter_jit
def _camera_picture(scene: Scene, camera: Camera, key: Array | None, plan: Plan) -> Picture:
    film, count = camera.film, plan.options.samples
    part = plan.part(camera)
    u = sobol_samples(count) if key is None else random_samples(count, key)
    u = u.astype(part.pixel.dtype)
    settings = ProgramSettings(plan.capacity, plan.keys, plan.options, plan.trace, None)
    span = frame_span(camera, part)
    key_time = picture_key_times(scene, span, plan.keys)

    def strip_values(top):
        return part_values(scene, camera, u, shift_part(part, top), settings, key_time)

    tops = strip_tops(film.height, plan.rows)
    if len(tops) == 1:
        values, report = strip_values(0)
        values = values.reshape(film.height, film.width, 5)
    else:
        # Backwards, one strip after another is traced again: memory is that of a strip.
        parts, report = jax.lax.map(jax.checkpoint(strip_values), jnp.asarray(tops))
        parts = parts.reshape(len(tops), plan.rows, film.width, 5)
        values = jnp.zeros((film.height, film.width, 5), parts.dtype)
        for top, piece in zip(tops, parts, strict=True):
            values = values.at[top : top + plan.rows].set(piece)
    needed = report.needed.reshape(-1, report.needed.shape[-1]).max(axis=0)
    keys, missing = plan.missing_keys(scene, span)
    dropped, needed = jnp.sum(report.dropped) + missing, jnp.append(needed, keys)
    return Picture(values[..., :3], values[..., 3], values[..., 4], dropped, needed)


@eqx.filter_jit
def _ray_picture(scene: Scene, rays: Rays, key: None, plan: Plan) -> Picture:
    shape, rays = rays.time.shape, flat_rays(rays)
    span = time_span(rays)
    motion = picture_motion(scene, span, plan.keys)
    keys, missing = plan.missing_keys(scene, span)
    order = coherent_order(rays)
    ordered = jax.tree.map(lambda x: x[order], rays)
    pixels, report = trace_rays(motion, ordered, options=plan.trace, capacity=plan.capacity)
    place = jnp.argsort(order)
    pixels = jax.tree.map(lambda x: x[place], pixels)
    alpha = 1 - pixels.transmittance
    depth = pixels.depth / jnp.maximum(alpha, 1e-6)
    color = pixels.color if rays.weight is None else pixels.color * rays.weight[:, None]
    return Picture(
        color.reshape(*shape, 3),
        alpha.reshape(shape),
        depth.reshape(shape),
        report.dropped + missing,
        jnp.append(report.needed, keys),
    )
