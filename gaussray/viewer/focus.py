"""Click to focus: the focus distance that makes the clicked surface sharp."""

import dataclasses

import jax
import jax.numpy as jnp

from gaussray.camera.aperture import no_aperture
from gaussray.camera.camera import Camera
from gaussray.render.aov.programs import SURFACE_ALPHA
from gaussray.viewer.preview import PreviewRenderer


def without_aperture(camera: Camera) -> Camera:
    """The camera with a pinhole aperture and without chromatic aberration: its chief rays only."""
    none = jax.tree.map(lambda x: x.astype(camera.time.dtype), no_aperture())
    return dataclasses.replace(camera, aperture=none, chromatic=None)


def clicked_focus_distance(
    previewer: PreviewRenderer, camera: Camera, pixel: tuple[int, int]
) -> float | None:
    """The focus distance of the surface in a pixel, in scene units.

    It is the surface's `depth` label, or its `z` label for a lens that focuses on a plane. None
    where the pixel shows no surface.

    Args:
        previewer: traces the pixel's chief ray.
        camera: the camera; of its aperture only `focus` counts.
        pixel: column and row of the pixel.
    """
    covered, distance = previewer.probe(without_aperture(camera), pixel)
    if covered < SURFACE_ALPHA:
        return None
    if camera.aperture.focus == "plane":
        point = jnp.asarray(pixel, camera.time.dtype) + 0.5
        distance *= float(camera.lens.direction(point)[2])
    return distance if distance > 0 else None
