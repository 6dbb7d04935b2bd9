"""Computes the labels of pixels from the surfaces that their rays meet, program by program."""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import PyTreeDef
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.rays import Rays
from gaussray.camera.rolling_projection import project_paths
from gaussray.render.aov.programs import (
    identity_program,
    lens_program,
    offset_program,
    on_host,
    path_program,
    surface_program,
    timing_program,
    view_program,
)
from gaussray.render.camera_layout import pack_camera
from gaussray.render.list_sizes import enlarge_program_capacity
from gaussray.render.parts import Part
from gaussray.render.picture_programs import lists_program, motion_program
from gaussray.tracer.options import TraceOptions, on_kernel
from gaussray.tracer.prepare import Prepared
from gaussray.tracer.traverse import Candidates, Capacity


# Labels of a surface, which are NaN where none is visible; labels that need the Gaussian with the
# largest weight; and labels of the ray itself, for which nothing is traced.
_SURFACE = ("depth", "z", "normal", "flow_forward", "flow_backward", "confusion", "blur")
_OF_DOMINANT = ("flow_forward", "flow_backward", "blur", "gaussian", "group", "moving")
OF_RAYS = ("time", "origin", "direction")


class FrameCameras(NamedTuple):
    """The camera of a frame, and those of the frames before and after it, None if there is none."""

    camera: Camera
    before: Camera | None
    after: Camera | None


class FlatScene(NamedTuple):
    """The arrays of a scene, and its structure."""

    leaves: list[Any]
    structure: PyTreeDef


class LabelSettings(NamedTuple):
    """How labels are traced.

    Args:
        trace: options of the tracer.
        keys: number of key states.
        capacity: list sizes.
    """

    trace: TraceOptions
    keys: int
    capacity: Capacity


class _Surfaces(NamedTuple):
    """The surfaces that the rays of a part hit, with a leading axis of one device.

    Args:
        labels: labels of the surfaces.
        rays: the chief rays.
        scene: the scene, prepared for the array backend.
        lists: its candidate lists.
    """

    labels: dict[str, Any]
    rays: Rays
    scene: Prepared
    lists: Candidates | None


def trace_labels(
    scene: FlatScene,
    cameras: FrameCameras,
    part: Part,
    pixel: Float[np.ndarray, "pixels 2"],
    names: tuple[str, ...],
    *,
    settings: LabelSettings,
) -> tuple[dict[str, np.ndarray], Capacity]:
    """The labels of these names for every pixel.

    Args:
        scene: the scene.
        cameras: the camera of the frame, and its neighbours.
        part: the pixels that are traced.
        pixel: their indices (column, row), in rows.
        names: names of labels.
        settings: how to trace; list sizes grow until nothing is dropped.

    Returns:
        The labels, and the list sizes that were enough.
    """
    row, layout = pack_camera(cameras.camera)
    part = jax.tree.map(lambda x: np.asarray(x)[None], part)
    slot = np.asarray(part.slot)
    rays, times, eye = view_program(layout)(row[None], part)
    chief = on_host(rays)
    of_rays = {name: getattr(chief, name)[0][slot[0]] for name in OF_RAYS}
    if set(names) <= set(OF_RAYS):
        return {name: of_rays[name] for name in names}, settings.capacity
    surfaces, capacity = _surfaces(scene, settings, (rays, times, eye), slot, names)
    labels, pixel = surfaces.labels, np.asarray(pixel, row.dtype)[None]
    if {"z", "confusion"} & set(names):
        lens = lens_program(layout, "confusion" in names)
        labels |= lens(row[None], pixel, labels["distance"], labels["time"])
    if set(names) & set(_OF_DOMINANT):
        identify = identity_program(scene.structure, _array_options(settings.trace), capacity.slots)
        inputs = surfaces.scene, surfaces.rays, surfaces.lists, slot, labels["valid"]
        identity, index = identify(scene.leaves, *inputs)
        labels |= identity
    else:
        index = np.zeros(labels["valid"].shape, np.int32)
    labels |= _motion_labels(scene, cameras, (pixel, index), labels, names)
    result = of_rays | on_host({name: labels[name] for name in names if name not in OF_RAYS})
    hidden = on_host(labels["valid"]) == 0
    for name in set(_SURFACE) & set(names):
        result[name] = np.where(
            hidden.reshape(-1, *(1,) * (result[name].ndim - 1)), np.nan, result[name]
        )
    return {name: result[name] for name in names}, capacity


def _array_options(trace: TraceOptions) -> TraceOptions:
    """The options with the array backend, if the CUDA kernel would trace."""
    return replace(trace, backend="array") if on_kernel(trace, jnp.float32) else trace


def _surfaces(
    scene: FlatScene, settings: LabelSettings, view: tuple, slot: np.ndarray, names: tuple[str, ...]
) -> tuple[_Surfaces, Capacity]:
    """What the rays of a view meet, and the list sizes that were enough for it."""
    rays, times, eye = view
    trace, keys, capacity = settings
    kernel, arrays = on_kernel(trace, jnp.float32), _array_options(trace)
    while True:
        sizes = keys, capacity.transient
        ready = motion_program(scene.structure, arrays, sizes, None, True)(scene.leaves, times)
        lists, report = None, None
        if not kernel or set(names) & set(_OF_DOMINANT):
            lists, _ = lists_program(arrays, capacity, None, True)(ready, rays)
            report = lists.needed, lists.dropped
        if report is None or not np.any(report[1]):
            # The CUDA kernels find lists of their own, in a scene without a grid.
            traced, own_lists = ready, lists
            if kernel:
                prepared = motion_program(scene.structure, trace, sizes, None, True)
                traced, own_lists = prepared(scene.leaves, times), None
            labels, shorter = surface_program(trace, capacity)(traced, rays, own_lists, eye, slot)
            if shorter is None or not np.any(shorter[1]):
                return _Surfaces(labels, rays, ready, lists), capacity
            report = shorter
        needed = [int(n) for n in np.asarray(report[0])[0]]
        capacity = enlarge_program_capacity(capacity, needed, staged=True)


def _motion_labels(
    scene: FlatScene,
    cameras: FrameCameras,
    pixels: tuple[np.ndarray, Array | np.ndarray],
    labels: dict[str, Any],
    names: tuple[str, ...],
) -> dict[str, Array | np.ndarray]:
    """Labels of motion on the picture.

    The visible point of a pixel moves with the Gaussian of the largest weight. A mean over all
    Gaussians would mix the motions of foreground and background. Where nothing moves, flow depends
    on the depth alone.
    """
    pixel, index = pixels
    time, offsets = np.asarray(labels["time"]), offset_program()
    carry = path_program(scene.structure)

    def path(other: Array | np.ndarray) -> Array:
        return carry(scene.leaves, index, labels["point"], labels["time"], other)

    def flow(other: Camera | None) -> Array | np.ndarray:
        if other is None:
            return np.full((*time.shape, 2), np.nan, time.dtype)
        row, layout = pack_camera(other)
        guess = jnp.asarray(time + np.asarray(other.time - cameras.camera.time), time.dtype)
        read = partial(timing_program(layout), row[None])
        fields = 1 if other.shutter.row_times is None else 2
        return offsets(*project_paths(path, read, guess, other.film, fields=fields), pixel)[0]

    def blur() -> np.ndarray:
        row, layout = pack_camera(cameras.camera)
        read, half = timing_program(layout), float(cameras.camera.shutter.exposure) / 2
        field, all_met = np.zeros(time.shape, np.int32), np.ones(time.shape, bool)
        moments = [np.asarray(time + side * half, time.dtype) for side in (-1, 1)]
        places = [read(row[None], path(moment), moment, field).pixel for moment in moments]
        before, after = (np.asarray(offsets(place, all_met, pixel)[1]) for place in places)
        return before + after

    ways = {
        "flow_forward": lambda: flow(cameras.after),
        "flow_backward": lambda: flow(cameras.before),
        "blur": blur,
    }
    return {name: way() for name, way in ways.items() if name in names}
