"""The compiled programs of labels; only small ones know the lens, all frames share the others.

All arguments and results have a leading axis of devices, of which there is one.
"""

import dataclasses
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import PyTreeDef
from jaxtyping import Array, Float, Int

from gaussray.camera.circle_of_confusion import circle_of_confusion
from gaussray.camera.rays import Rays
from gaussray.camera.rolling_projection import RowTiming, row_timing
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import normalize, safe_norm
from gaussray.render.camera_layout import CameraLayout
from gaussray.render.frame_times import frame_span, key_times
from gaussray.render.parts import Part
from gaussray.render.picture_programs import on_devices
from gaussray.render.samples import sample_points, sample_rays
from gaussray.runtime.program_cache import ProgramCache
from gaussray.scene.normals import normals
from gaussray.scene.point_tracks import STATIC, group_of, point_path
from gaussray.tracer.dominant import dominant
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.prepare import Prepared
from gaussray.tracer.trace import march_function, march_lists, trace
from gaussray.tracer.traverse import Candidates, Capacity
from gaussray.tracer.vector_blend import blended_vector, color_by_vector


# Coverage from which a surface counts as visible.
SURFACE_ALPHA = 0.5
# Pixels whose motion is computed at once.
_PIXELS = 1 << 16


@ProgramCache(48)
def view_program(layout: CameraLayout) -> Callable:
    """(numbers of a camera, part) -> chief rays by slot, with an axis of one sample; the times of
    the frame, as `motion_program` takes them; the camera's position at the frame's own time."""

    def run(row: Array, part: Part) -> tuple[Rays, tuple[Array, Array], Float[Array, "3"]]:
        camera = layout.camera(row)
        rays = sample_rays(camera, part.pixel, sample_points(part, 1), None)
        eye = pose_at(camera.trajectory, camera.time).translation
        return rays, (key_times(camera, part, 0), frame_span(camera, part)), eye

    return on_devices(run, None, (layout,))


@ProgramCache(48)
def lens_program(layout: CameraLayout, confusion: bool) -> Callable[..., dict[str, Array]]:
    """(numbers of a camera, pixels, distances, times) -> depth `z` along the camera's axis.

    Args:
        layout: layout of the camera's numbers.
        confusion: whether to compute the circle of confusion, too.
    """

    def run(row: Array, pixel: Array, distance: Array, time: Array) -> dict[str, Array]:
        camera = layout.camera(row)

        def one(arguments: tuple[Array, Array, Array]) -> dict[str, Array]:
            pixel, t, time = arguments
            found = {"z": t * camera.lens.direction(pixel + 0.5)[2]}
            if confusion:
                found["confusion"] = circle_of_confusion(camera, pixel, t, time)
            return found

        return _map_pixels(one, (pixel, distance, time))

    return on_devices(run, None, (layout, confusion))


@ProgramCache(48)
def timing_program(layout: CameraLayout) -> Callable[..., RowTiming]:
    """(numbers of a camera, world points, times, fields) -> the `RowTiming` of each."""

    def run(row: Array, point: Array, time: Array, field: Array) -> RowTiming:
        camera = layout.camera(row)
        return _map_pixels(lambda x: row_timing(camera, *x), (point, time, field))

    return on_devices(run, None, (layout,))


@ProgramCache(12)
def surface_program(trace_options: TraceOptions, capacity: Capacity) -> Callable:
    """(scene, rays, lists or None, place of the camera, slots of the pixels) -> labels of the
    surfaces that rays meet and where that is; sizes needed and entries dropped, if it finds the
    lists itself.

    Args:
        trace_options: how rays are traced.
        capacity: sizes of the lists.
    """

    def run(
        scene: Prepared, rays: Rays, lists: Candidates | None, eye: Array, slot: Array
    ) -> tuple[dict[str, Array], tuple[Array, Array] | None]:
        facing = color_by_vector(scene.motion, partial(normals, eye=eye), 1.0)
        report = None
        if lists is None:
            ready = dataclasses.replace(scene, motion=facing)
            pixels, found = trace(ready, rays, options=trace_options, capacity=capacity)
            report = found.needed, found.dropped
        else:
            pixels, _ = march_lists(
                facing, rays, lists, options=trace_options, slots=capacity.slots
            )
        pixels = jax.tree.map(lambda x: x[0, slot], pixels)
        chief: Rays = jax.tree.map(lambda x: x[0, slot], rays)
        alpha = 1 - pixels.transmittance
        depth, visible = pixels.depth / jnp.maximum(alpha, SURFACE_ALPHA), alpha >= SURFACE_ALPHA
        distance = jnp.where(visible, depth, 1)
        labels = {
            "alpha": alpha,
            "depth": depth,
            "normal": normalize(blended_vector(pixels, 1.0)),
            "valid": visible.astype(jnp.uint8),
            "time": chief.time,
            "distance": distance,
            "point": chief.origin + distance[:, None] * chief.direction,
        }
        return labels, report

    # A program of machine code is read from disk only after that has been made known to XLA.
    kind = march_function(trace_options, jnp.float32).__name__
    return on_devices(run, None, (trace_options, capacity, kind))


@ProgramCache(12)
def identity_program(structure: PyTreeDef, options: TraceOptions, slots: int) -> Callable:
    """(leaves of a scene, scene, rays, lists, slots of the pixels, which show a surface) ->
    labels `gaussian` (-1 where no surface is visible), `group` and `moving` (0 there) of every
    pixel; and the index of the pixel's Gaussian, -1 where none is hit.

    Args:
        structure: structure of the scene.
        options: how rays are traced, with the array backend.
        slots: length of the longest list.
    """

    def run(
        leaves: list[Array],
        ready: Prepared,
        rays: Rays,
        lists: Candidates,
        slot: Array,
        valid: Array,
    ) -> tuple[dict[str, Array], Int[Array, " pixels"]]:
        scene, single = jax.tree.unflatten(structure, leaves), jax.tree.map(lambda x: x[0], rays)
        fixed = jax.lax.stop_gradient((ready, single))
        best = dominant(*fixed, lists, options=options, slots=slots)
        index = best.index[slot]
        visible = (index >= 0) & (valid > 0)
        group = jnp.where(visible, group_of(scene)[jnp.maximum(index, 0)], 0)
        labels = {
            "gaussian": jnp.where(visible, index, -1),
            "group": group,
            "moving": (group > STATIC).astype(jnp.uint8),
        }
        return labels, index

    return on_devices(run, None, (structure, options, slots), common=(0,))


@ProgramCache(12)
def path_program(structure: PyTreeDef) -> Callable[..., Float[Array, "devices pixels 3"]]:
    """(leaves of a scene, indices of Gaussians, points, times, other times) -> the points, each of
    which moves with its Gaussian, at the other times."""

    def run(leaves: list[Array], index: Array, point: Array, time: Array, other: Array) -> Array:
        scene = jax.tree.unflatten(structure, leaves)

        def one(arguments: tuple[Array, Array, Array, Array]) -> Array:
            index, point, time, other = arguments
            return point_path(scene, index, point, time)(other)

        return _map_pixels(one, (index, point, time, other))

    return on_devices(run, None, (structure,), common=(0,))


@ProgramCache(1)
def offset_program() -> Callable[..., tuple[Array, Array]]:
    """(places, whether they count, pixels) -> vectors from the pixels' middles, NaN where they do
    not count; and their lengths."""

    def run(position: Array, met: Array, pixel: Array) -> tuple[Array, Array]:
        offset = position - (pixel + 0.5)
        return jnp.where(met[:, None], offset, jnp.nan), safe_norm(offset)

    return on_devices(run, None, ())


def _map_pixels(function: Callable, pixels: tuple[Array, ...]):
    """A function of one pixel for all of them, so many at once that memory is bounded."""
    return jax.lax.map(function, pixels, batch_size=min(_PIXELS, pixels[0].shape[0]))


def on_host(tree):
    """Values of one device on the host."""
    return jax.tree.map(lambda x: np.asarray(x)[0], tree)
