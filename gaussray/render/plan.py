"""The static sizes of a differentiable picture: list sizes and key states."""

import dataclasses
import functools
from collections import OrderedDict
from collections.abc import Hashable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from gaussray.camera.camera import Camera, check_camera
from gaussray.camera.rays import Rays
from gaussray.camera.shutter import time_window
from gaussray.io.validate import check_kind
from gaussray.render.compiled import ProgramSettings
from gaussray.render.list_sizes import NO_LISTS
from gaussray.render.measured_capacity import single_program_capacity
from gaussray.render.options import RenderOptions
from gaussray.render.parts import Part, strip_part, strip_plan, strip_tops, whole_picture
from gaussray.scene.scene import Scene, key_count, key_count_of
from gaussray.scene.segmented import SCENE_RULE, Clip
from gaussray.tracer.measure import enlarged_capacity, measure
from gaussray.tracer.motion import Motion, key_times_across, scene_motion
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.prepare import time_span
from gaussray.tracer.traverse import Capacity


# Key states of a frame without duration span this share of the scene's times, so that derivatives
# by a time exist.
LEAST_SPAN = 1e-2
# Plans that are kept for pictures that are traced without one.
_MOST_PLANS = 64


class NumbersNeeded(ValueError):
    """A plan was asked for with traced arguments."""


class Plan(eqx.Module):
    """Static sizes of a picture's program: it holds no arrays, and changing it recompiles.

    Args:
        capacity: sizes of the tracer's lists.
        keys: number of states of the scene across the times of the picture.
        rows: rows of the picture that are traced at once; 0 for rays.
        options: how the picture is sampled.
        trace: how rays are traced.
    """

    capacity: Capacity
    keys: int = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    options: RenderOptions
    trace: TraceOptions

    def enlarged(self, needed: Array) -> "Plan":
        """The plan with list sizes and key states for a picture that needed more
        (`Picture.needed`)."""
        *sizes, keys = (int(n) for n in np.asarray(needed))
        capacity = enlarged_capacity(self.capacity, sizes)
        return dataclasses.replace(self, capacity=capacity, keys=max(self.keys, keys))

    def missing_keys(
        self, scene: Scene, span: Float[Array, "2"]
    ) -> tuple[Int[Array, ""], Int[Array, ""]]:
        """The number of key states that a picture of these times needs, and how many of them the
        plan has not. With `RenderOptions.keys` it needs no more than these.

        Args:
            scene: the scene.
            span: first and last time of the picture's rays.
        """
        if self.options.keys:
            return jnp.full((), self.keys), jnp.zeros((), jnp.int32)
        wanted = key_count_of(scene, jax.lax.stop_gradient(span[1] - span[0]))
        return wanted, jnp.maximum(wanted - self.keys, 0)

    def part(self, camera: Camera) -> Part:
        """The first rows of a picture, as many as are traced at once, in the precision of the
        camera."""
        film = camera.film
        if self.rows == film.height:
            part, _ = whole_picture(film, self.trace)
        else:
            part, _ = strip_part(film, self.rows, self.trace, 0)
        dtype = jnp.result_type(*jax.tree.leaves(camera))
        return dataclasses.replace(part, pixel=part.pixel.astype(dtype))


def plan(
    scene: Scene,
    camera: Camera | Rays,
    *,
    options: RenderOptions | None = None,
    trace: TraceOptions | None = None,
) -> Plan:
    """Measure the static sizes of `render` (for a camera) or `render_rays` (for rays).

    Other scenes, cameras and rays may need 1.5 times as much, and last no longer; a picture that
    needs more reports it (`Picture.dropped`).

    Args:
        scene: the scene; a clip's segments are scenes.
        camera: a camera or rays like those to come. Of numbers, outside of `jit` and `vmap`.
        options: how a picture is sampled: `samples`, `keys`, `memory`, `dilation`, `harmonics`.
        trace: how rays are traced.

    Raises:
        ValueError: The scene is a clip, the arguments are traced, the options ask for what only
            `Renderer` does (`chunk_rows` or `error`), or the parts of the camera do not go together
            (`check_camera`).
    """
    options, trace = options or RenderOptions(), trace or TraceOptions()
    check_kind("camera", camera, (Camera, Rays), "a gaussray.Camera or gaussray.Rays")
    check_renderable(scene, options)
    scene, camera = jax.tree.map(jax.lax.stop_gradient, (scene, camera))
    if any(isinstance(x, Tracer) for x in jax.tree.leaves((scene, camera))):
        raise NumbersNeeded(
            "gaussray.plan needs the numbers of a scene and a camera: call it outside of jit and "
            "vmap."
        )
    if isinstance(camera, Rays):
        return _plan_of_rays(scene, camera, options, trace)
    check_camera(camera)
    return _plan_of_camera(scene, camera, options, trace)


def check_renderable(scene: Scene, options: RenderOptions) -> None:
    """Check that a scene and options can be rendered by one program.

    Args:
        scene: the scene.
        options: how the picture is sampled.

    Raises:
        ValueError: The scene is none or a clip, or the options need several programs.
    """
    check_kind("scene", scene, (Scene, Clip), SCENE_RULE)
    check_kind("options", options, RenderOptions, "gaussray.RenderOptions(...)")
    if isinstance(scene, Clip):
        raise ValueError(
            f"scene must be one Scene, got a Clip of {len(scene.segments)} segments: use one of "
            "its `segments`, or gaussray.Renderer, which joins them."
        )
    for key in ("chunk_rows", "error"):
        if getattr(options, key):
            raise ValueError(
                f"options.{key} must be 0 here, got {getattr(options, key)}: gaussray.Renderer "
                "takes several programs to one picture."
            )


def _plan_of_camera(
    scene: Scene, camera: Camera, options: RenderOptions, trace: TraceOptions
) -> Plan:
    film = camera.film
    first, last = time_window(camera.shutter, (film.width, film.height))
    keys = _keys(scene, last - first, options)
    rows, trace = strip_plan(film, options, trace, scene.count)
    make = functools.partial(strip_part, rows=rows, top=0) if rows < film.height else whole_picture
    _, trace = make(film, trace=trace)
    unmeasured = Plan(NO_LISTS, keys, rows, options, trace)
    settings = ProgramSettings(NO_LISTS, keys if last > first else 1, options, trace, None)
    strips = [shift_part(unmeasured.part(camera), top) for top in strip_tops(film.height, rows)]
    sizes = [single_program_capacity(scene, camera, x, settings=settings) for x in strips]
    return dataclasses.replace(unmeasured, capacity=_largest(sizes))


def _plan_of_rays(scene: Scene, rays: Rays, options: RenderOptions, trace: TraceOptions) -> Plan:
    rays = flat_rays(rays)
    span = time_span(rays)
    keys = _keys(scene, float(span[1] - span[0]), options)
    trace = dataclasses.replace(trace, levels=0)
    motion = eqx.filter_jit(picture_motion)(scene, span, keys)
    capacity = measure(motion, rays, options=trace)
    return Plan(capacity, keys, 0, options, trace)


def picture_motion(scene: Scene, span: Float[Array, "2"], keys: int) -> Motion:
    """The motion of a scene across the times of a picture.

    Args:
        scene: the scene.
        span: first and last time of the picture.
        keys: number of key states.
    """
    return scene_motion(scene, picture_key_times(scene, span, keys), scene.time_range)


def picture_key_times(scene: Scene, span: Float[Array, "2"], keys: int) -> Float[Array, " keys"]:
    """Times of the key states of a picture.

    They span at least `LEAST_SPAN` of the scene's times, so that derivatives by a time exist.

    Args:
        scene: the scene.
        span: first and last time of the picture.
        keys: number of key states.
    """
    if keys == 1:
        return jnp.mean(span, keepdims=True)
    least = LEAST_SPAN * (scene.time_range[1] - scene.time_range[0])
    return key_times_across(span[0], span[1], keys, least=least)


def flat_rays(rays: Rays) -> Rays:
    """Rays of any shape as a list."""

    def flat(x: Array, *trailing: int) -> Array:
        return x.reshape(-1, *trailing)

    more = (None if x is None else flat(x) for x in (rays.weight, rays.start))
    return Rays(flat(rays.origin, 3), flat(rays.direction, 3), flat(rays.time), *more)


def shift_part(part: Part, top: Array | int) -> Part:
    """Shift the pixels of a part down.

    Args:
        part: the pixels.
        top: number of rows.
    """
    shift = jnp.stack([jnp.zeros((), part.pixel.dtype), jnp.asarray(top, part.pixel.dtype)])
    return dataclasses.replace(part, pixel=part.pixel + shift[None], row=part.row + top)


def _keys(scene: Scene, span: float, options: RenderOptions) -> int:
    if scene.deformation is None:
        return 1
    return options.keys or (key_count(scene, span) if span > 0 else 1)


def _largest(sizes: Sequence[Capacity]) -> Capacity:
    return Capacity(
        tuple(max(cells) for cells in zip(*(s.cells for s in sizes), strict=True)),
        *(max(getattr(s, k) for s in sizes) for k in ("pairs", "slots", "transient")),
    )


class PlanCache:
    """The latest plans, by structure and shapes of the arguments that they were measured for."""

    def __init__(self):
        self._plans: OrderedDict[Hashable, Plan] = OrderedDict()

    def get(self, key: Hashable) -> Plan | None:
        """The plan of a key; None if there is none."""
        return self._plans.get(key)

    def put(self, key: Hashable, plan: Plan) -> None:
        """Keep a plan and forget the oldest beyond `_MOST_PLANS`.

        Args:
            key: key of the arguments that it was measured for (`plan_key`).
            plan: the plan; it replaces an earlier one of the same key.
        """
        self._plans[key] = plan
        self._plans.move_to_end(key)
        if len(self._plans) > _MOST_PLANS:
            self._plans.popitem(last=False)


def plan_key(*arguments: Any) -> Hashable:
    """Key of a plan: structure, shapes and types of the arguments."""
    leaves, structure = jax.tree.flatten(arguments)
    return structure, tuple((x.shape, jnp.result_type(x)) for x in leaves)
