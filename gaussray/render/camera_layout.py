"""Packs a camera into one row of numbers for the transfer to a device."""

import dataclasses
import math
from collections.abc import Hashable
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


class _Packing(NamedTuple):
    """What `pack_camera` makes of all cameras of one structure.

    Args:
        layout: layout of the row.
        sources: for each array of the layout which array of the camera it is, or the array itself
            where it follows from the structure alone.
    """

    layout: CameraLayout
    sources: tuple[int | np.ndarray, ...]


# By structure, precision, shapes and types; cleared when it has grown to the given size.
_packings: dict[Hashable, _Packing] = {}
_MOST = 256


def pack_camera(camera: Camera) -> tuple[Float[np.ndarray, " numbers"], CameraLayout]:
    """A camera on the host as one row of numbers, with their layout.

    The number of aperture blades and the direction of the shutter become numbers: cameras that
    differ in them share their programs.
    """
    leaves, structure = jax.tree.flatten(camera)
    leaves = [np.asarray(x) for x in leaves]
    # The precision of devices may change while a process runs.
    key = structure, jnp.result_type(float), tuple((x.shape, x.dtype) for x in leaves)
    packing = _packings.get(key)
    if packing is None:
        if len(_packings) >= _MOST:
            _packings.clear()
        packing = _packings[key] = _packing(camera)
    layout = packing.layout
    parts = [leaves[x] if isinstance(x, int) else x for x in packing.sources]
    typed = zip(parts, layout.dtypes, strict=True)
    return np.concatenate([x.astype(dtype).ravel() for x, dtype in typed]), layout


def _packing(camera: Camera) -> _Packing:
    """How to pack cameras like this one. Their classes send every number to the device and back,
    which takes longer than to render a picture there: this is done once for all of them."""
    size = camera.film.width, camera.film.height
    there = jax.tree.map(to_device, camera)
    aperture, shutter = with_edges(there.aperture), with_readout_factors(there.shutter, size)
    there = jax.device_get(dataclasses.replace(there, aperture=aperture, shutter=shutter))
    given = [path for path, _ in jax.tree.leaves_with_path(camera)]
    packed = jax.tree.leaves_with_path(there)
    leaves = [x for _, x in packed]
    layout = CameraLayout(
        jax.tree.structure(there), tuple(x.shape for x in leaves), tuple(x.dtype for x in leaves)
    )
    return _Packing(layout, tuple(given.index(at) if at in given else x for at, x in packed))
