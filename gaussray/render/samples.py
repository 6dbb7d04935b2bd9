"""The samples of a picture's pixels, and their rays."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.rays import Rays
from gaussray.camera.sampling import shifted_samples, sobol_samples
from gaussray.camera.shutter import row_number
from gaussray.render.parts import Part


def sample_points(part: Part, count: int) -> Float[Array, "samples 5"]:
    """Samples of every pixel: the same for all pictures, or those of the part's batch.

    Args:
        part: the pixels.
        count: number of samples.
    """
    u = sobol_samples(count) if part.batch is None else shifted_samples(count, part.batch)
    return u.astype(part.pixel.dtype)


def sample_rays(
    camera: Camera,
    pixel: Array,
    u: Float[Array, "samples 5"],
    mask: Bool[Array, "samples rows"] | None,
    magnification: Float[Array, ""] | None = None,
) -> Rays:
    """Rays of all samples of pixels.

    Args:
        camera: the camera.
        pixel: indices (column, row) of the pixels.
        u: the samples (`camera.camera_ray`).
        mask: samples and rows that this segment traces; the other rays get no direction. None is
            all of them.
        magnification: of one colour channel; None is the lens itself.
    """
    size = camera.film.width, camera.film.height

    def sample(point: Float[Array, "5"], mask: Bool[Array, " rows"] | None) -> Rays:
        points = jnp.broadcast_to(point, (pixel.shape[0], 5))
        rays = camera_rays(camera, pixel, points, magnification)
        if mask is None:
            return rays
        row = jax.vmap(lambda p: row_number(camera.shutter, p, size))(pixel).astype(jnp.int32)
        direction = jnp.where(mask[row][:, None], rays.direction, 0)
        return dataclasses.replace(rays, direction=direction)

    return jax.vmap(sample)(u, mask)
