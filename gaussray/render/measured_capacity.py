"""The list capacity that a part of a picture needs, measured before it is rendered."""

import dataclasses

import jax
from jax.tree_util import PyTreeDef
from jax.typing import DTypeLike

from gaussray.camera.camera import Camera
from gaussray.render.camera_layout import CameraLayout
from gaussray.render.compiled import ProgramSettings, prepare_trace
from gaussray.render.list_sizes import NO_LISTS, default_capacity, enlarge_program_capacity
from gaussray.render.parts import Part
from gaussray.render.picture_programs import StageArguments, measure_staged
from gaussray.scene.scene import Scene
from gaussray.tracer.measure import HEADROOM, measure
from gaussray.tracer.traverse import Capacity


def single_program_capacity(
    scene: Scene,
    camera: Camera,
    part: Part,
    *,
    settings: ProgramSettings,
    headroom: float = HEADROOM,
) -> Capacity:
    """The capacity for a picture that one program renders (`compiled`), on one device.

    Args:
        scene: the scene.
        camera: the camera.
        part: the pixels.
        settings: the program's settings, of which capacity and mesh are ignored.
        headroom: factor of the needed sizes, for other frames.
    """
    settings = dataclasses.replace(settings, capacity=NO_LISTS, mesh=None)
    motion, rays = prepare_trace(scene, camera, part, settings=settings)
    return measure(motion, rays, options=settings.trace, headroom=headroom)


def staged_capacity(
    structure: PyTreeDef,
    layout: CameraLayout,
    settings: ProgramSettings,
    arguments: StageArguments,
    dtype: DTypeLike,
) -> Capacity:
    """The capacity for a picture that is rendered in stages (`picture_programs`).

    It holds the first sample of the part, and at least the lists of an ordinary scene.

    Args:
        structure, layout, arguments: as for `render_staged`.
        settings: as for `render_staged`, of which the capacity is ignored.
        dtype: precision of the rays.
    """
    leaves, _, part = arguments
    scene = jax.tree.unflatten(structure, leaves)
    least = default_capacity(part, settings.trace, scene, dtype)
    settings = dataclasses.replace(settings, capacity=least)
    needed = measure_staged(structure, layout, settings, arguments)
    return enlarge_program_capacity(least, needed, staged=True)
