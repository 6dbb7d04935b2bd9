"""Lateral chromatic aberration: a lens images red, green and blue at sizes of their own."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.lens import AbstractLens
from gaussray.camera.principal_point import axis_of
from gaussray.camera.validate import require


class Magnified(AbstractLens):
    """A lens whose picture is `magnification` times as large, about the optical axis.

    What `lens` images at the pixel a + d, with the axis at a, this one images at a + m d.
    """

    lens: AbstractLens
    magnification: Float[Array, ""]

    def direction(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        axis = axis_of(self.lens, pixel.dtype)
        return self.lens.direction(axis + (pixel - axis) / self.magnification)

    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        axis = axis_of(self.lens, point.dtype)
        return axis + self.magnification * (self.lens.project(point) - axis)

    def check(self) -> None:
        _require_magnification(self.magnification)


class Chromatic(AbstractLens):
    """A lens with a `magnification` for each of red, green and blue, to first order in the distance
    from the axis; `lens` is what all of them are where it is 1, and what the geometry goes by.
    """

    lens: AbstractLens
    magnification: Float[Array, "3"]

    def direction(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        return self.lens.direction(pixel)

    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        return self.lens.project(point)

    def check(self) -> None:
        _require_magnification(self.magnification)


def dispersed(camera: Camera, magnification: tuple[float, ...]) -> Camera:
    """The camera with these magnifications of red, green and blue; all 1 is the camera itself."""
    if all(m == 1 for m in magnification):
        return camera
    lens = Chromatic(camera.lens, jnp.asarray(magnification, camera.time.dtype))
    return dataclasses.replace(camera, lens=lens)


def achromatic(camera: Camera) -> Camera:
    """The camera as its geometry has it, without chromatic aberration."""
    if not isinstance(camera.lens, Chromatic):
        return camera
    return dataclasses.replace(camera, lens=camera.lens.lens)


def magnified(camera: Camera, magnification: Float[Array, ""]) -> Camera:
    """A camera as one colour has it."""
    lens = Magnified(achromatic(camera).lens, magnification)
    return dataclasses.replace(camera, lens=lens)


def _require_magnification(value: Float[Array, "..."]) -> None:
    rule = "above 0"
    require("lens.magnification", value, lambda m: np.isfinite(m) & (m > 0), rule)
