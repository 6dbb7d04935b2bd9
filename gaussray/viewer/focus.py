"""Where the focus must be for what one points at to be sharp."""

import dataclasses

import jax
import jax.numpy as jnp

from gaussray.camera.aperture import no_aperture
from gaussray.camera.camera import Camera
from gaussray.render.aov.trace import COVERED
from gaussray.viewer.preview import Sketcher


def pointing(camera: Camera) -> Camera:
    """The camera of chief rays alone: what is seen where, of whatever opening."""
    none = jax.tree.map(lambda x: x.astype(camera.time.dtype), no_aperture())
    return dataclasses.replace(camera, aperture=none, chromatic=None)


def focus_at(sketcher: Sketcher, camera: Camera, pixel: tuple[int, int]) -> float | None:
    """The focus distance of what a pixel (column, row) shows: the `depth` of the labels, for a lens
    that focuses on a plane their `z`. None where no surface is seen."""
    covered, distance = sketcher.probe(pointing(camera), pixel)
    if covered < COVERED:
        return None
    if camera.aperture.focus == "plane":
        place = jnp.asarray(pixel, camera.time.dtype) + 0.5
        distance *= float(camera.lens.direction(place)[2])
    return distance if distance > 0 else None
