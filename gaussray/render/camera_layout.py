"""Packs a camera into one row of numbers for the transfer to a device."""

import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import PyTreeDef
from jaxtyping import Array, Float

from gaussray.camera.aperture import with_edges
from gaussray.camera.camera import Camera
from gaussray.camera.shutter import with_readout_factors
from gaussray.io.plain_values import to_device


class CameraLayout(NamedTuple):
    """Structure, shapes and types of a camera's arrays, which are sent to the device as one row of
    numbers: one transfer instead of a dozen."""

    structure: PyTreeDef
    shapes: tuple[tuple[int, ...], ...]
    dtypes: tuple[np.dtype, ...]

    def camera(self, row: Float[Array, " numbers"]) -> Camera:
        """The camera of a row of numbers."""
        ends = np.cumsum([math.prod(shape) for shape in self.shapes])
        parts = jnp.split(row, ends[:-1])
        arrays = zip(parts, self.shapes, self.dtypes, strict=True)
        return jax.tree.unflatten(self.structure, [x.reshape(s).astype(d) for x, s, d in arrays])


def pack_camera(camera: Camera) -> tuple[Float[np.ndarray, " numbers"], CameraLayout]:
    """A camera on the host as one row of numbers, with their layout.

    The number of aperture blades and the direction of the shutter become numbers: cameras that
    differ in them share their programs.
    """
    size = camera.film.width, camera.film.height
    camera = jax.tree.map(to_device, camera)
    aperture, shutter = with_edges(camera.aperture), with_readout_factors(camera.shutter, size)
    camera = jax.device_get(dataclasses.replace(camera, aperture=aperture, shutter=shutter))
    leaves, structure = jax.tree.flatten(camera)
    layout = CameraLayout(structure, tuple(x.shape for x in leaves), tuple(x.dtype for x in leaves))
    return np.concatenate([x.ravel() for x in leaves]), layout
