"""Effects of Gaussian rasterisers, for models that were fitted with one."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.lens import Pinhole
from gaussray.camera.principal_point import axis_of
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import normalize, safe_norm
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics, radiance


def dilate(gaussians: Gaussians, camera: Camera, variance: float) -> Gaussians:
    """Widen Gaussians on the screen (3DGS adds 0.3 square pixels).

    scale' = sqrt(scale^2 + variance a) on every axis, a the area of a pixel where the Gaussian is,
    across the ray. What 3DGS adds on the screen is a disc; this is an ellipse of the same area, at
    the angle t from the axis 1 / sqrt(cos t) times as long towards the middle and sqrt(cos t) times
    as wide. Pixels of a pinhole have their own area each, those of other lenses that of the one on
    the axis. Opacities are unchanged, as in 3DGS.

    Args:
        gaussians: the Gaussians; scales may have leading axes of times.
        camera: the camera.
        variance: in square pixels.
    """
    area = _pixel_area(gaussians.mean, camera)
    wider = jnp.sqrt(gaussians.scale**2 + variance * area[..., None])
    return dataclasses.replace(gaussians, scale=wider)


def colors_from_center(
    gaussians: Gaussians, camera: Camera, mean: Float[Array, "gaussians 3"]
) -> Gaussians:
    """Gaussians of one colour each, evaluated as in 3DGS: in the direction from the camera to their
    centres, at the frame's own time.

    Args:
        gaussians: the Gaussians.
        camera: the camera.
        mean: centres of the Gaussians, in scene units.
    """
    eye = pose_at(camera.trajectory, camera.time).translation
    direction = jax.vmap(normalize)(mean - eye[None])
    color = radiance(jnp.moveaxis(gaussians.harmonics, 0, -1), direction.T).T
    return dataclasses.replace(gaussians, harmonics=constant_harmonics(color, 0))


def _pixel_area(mean: Float[Array, "*times n 3"], camera: Camera) -> Float[Array, "*times n"]:
    """Area of a pixel across the ray, at the distance of each Gaussian."""
    pose, lens = pose_at(camera.trajectory, camera.time), camera.lens

    def area(one: Float[Array, "3"]) -> Array:
        point = pose.inverse_apply(one)
        distance = safe_norm(point)
        if not isinstance(lens, Pinhole):
            return distance**2 * _pixel_on_axis(camera)
        # A pixel of the plane z = 1, seen under the cosine z / distance.
        cosine = jnp.abs(point[2]) / jnp.maximum(distance, jnp.finfo(point.dtype).tiny)
        return point[2] ** 2 * cosine / (lens.focal[0] * lens.focal[1])

    return jnp.vectorize(area, signature="(k)->()")(mean)


def _pixel_on_axis(camera: Camera) -> Float[Array, ""]:
    """Solid angle of the pixel on the optical axis; in the middle of the film, if the lens does not
    image its axis."""
    film, direction = camera.film, camera.lens.direction
    middle = jnp.asarray([film.width / 2, film.height / 2], camera.time.dtype)
    axis = axis_of(camera.lens, middle.dtype)
    middle = jnp.where(jnp.isfinite(axis), axis, middle)
    across, along = jnp.eye(2, dtype=middle.dtype) / 2
    u = direction(middle + across) - direction(middle - across)
    v = direction(middle + along) - direction(middle - along)
    return safe_norm(jnp.cross(u, v))
