"""Batches: the tiles that a training step renders, their rays and their colours."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.rays import Rays
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import tile_grid, tile_order


class Batch(eqx.Module):
    """Tiles of one timestamp; with a leading axis, those of many steps.

    Args:
        frame: the frame of each tile.
        tile: the number of each tile in its frame.
        time: the timestamp of the step.
        pixel: sRGB-encoded colours, 8-bit levels or floats in 0..1.
        visible: False where a pixel is ignored; None if all count.
    """

    frame: Int[Array, "*steps tiles"]
    tile: Int[Array, "*steps tiles"]
    time: Float[Array, "*steps"]
    pixel: Shaped[Array, "*steps tiles pixels 3"]
    visible: Bool[Array, "*steps tiles pixels"] | None

    @property
    def side(self) -> int:
        """Pixels along a tile's side."""
        return math.isqrt(self.pixel.shape[-2])


def gather(
    footage: Footage,
    frame: Int[np.ndarray, "steps tiles"],
    tile: Int[np.ndarray, "steps tiles"],
    time: Float[np.ndarray, " steps"],
) -> Batch:
    """Copy the tiles of many steps from the host to the device.

    Args:
        footage: the training pictures.
        frame: the frame of each tile that a step draws.
        tile: the number of each tile in its frame.
        time: the timestamp of each step.

    Returns:
        A batch with a leading axis of steps.
    """
    parts = (frame, tile, time, footage.pixel[frame, tile], footage.visible(frame, tile))
    return Batch(*(None if x is None else jnp.asarray(x) for x in parts))  # type: ignore[arg-type]


def tile_rays(
    camera: Camera,
    tile: Int[Array, " tiles"],
    u: Float[Array, "samples 5"],
    *,
    side: int,
    bundle: int | None = None,
) -> Rays:
    """Rays through the pixels of tiles, tile after tile in `tile_order`, for every sample.

    Args:
        camera: the stacked cameras, one per tile.
        tile: the number of each tile in its picture.
        u: sample numbers in [0, 1) of pixel, aperture and shutter (`camera_ray`).
        side: pixels along the side of a tile.
        bundle: pixels along the side of a ray bundle.

    Returns:
        Rays (samples, tiles x pixels).
    """
    width, height = camera.film.width, camera.film.height
    columns, _ = tile_grid(camera.film, side)
    dy, dx = np.divmod(tile_order(side, bundle), side)

    def one(camera: Camera, tile: Array, u: Array) -> Rays:
        left = jnp.minimum(tile % columns * side, width - side)
        top = jnp.minimum(tile // columns * side, height - side)
        pixel = jnp.stack([left + dx, top + dy], axis=-1)
        pixel = pixel.astype(camera.time.dtype)
        return camera_rays(camera, pixel, jnp.broadcast_to(u, (side * side, u.shape[0])))

    each = jax.vmap(jax.vmap(one, in_axes=(0, 0, None)), in_axes=(None, None, 0))
    rays = each(camera, tile, u.astype(camera.time.dtype))
    return jax.tree.map(lambda x: x.reshape(x.shape[0], -1, *x.shape[3:]), rays)


def tile_colors(batch: Batch) -> tuple[Float[Array, "rays 3"], Float[Array, " rays"]]:
    """Encoded colours in [0, 1] of the pixels of one step, in the order of `tile_rays`, and their
    weights: 0 for pixels that are ignored, else 1."""
    dtype = batch.time.dtype
    scale = 255 if batch.pixel.dtype == jnp.uint8 else 1
    color = jnp.asarray(batch.pixel, dtype).reshape(-1, 3) / scale
    if batch.visible is None:
        return color, jnp.ones(color.shape[0], dtype)
    return color, jnp.asarray(batch.visible, dtype).reshape(-1)
