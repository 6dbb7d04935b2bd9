"""Effects of Gaussian rasterisers, for models that were fitted with one."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.lens import Pinhole
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import normalize, safe_norm
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics, radiance


def dilate(gaussians: Gaussians, camera: Camera, variance: float) -> Gaussians:
    """Widen Gaussians on the screen (3DGS adds 0.3 square pixels).

    scale' = sqrt(scale^2 + variance w^2) on every axis, w the width of a pixel at the Gaussian's
    distance: the depth along the axis for a pinhole, else the distance to the lens, times the angle
    of the middle pixel. This equals what 3DGS adds on the screen, to first order in the Gaussian's
    size over its distance; opacities are unchanged, as there.

    Args:
        gaussians: The Gaussians; scales may have leading axes of times.
        camera: The camera.
        variance: In square pixels.
    """
    width = _distance(gaussians.mean, camera) * _pixel_angle(camera)
    wider = jnp.sqrt(gaussians.scale**2 + variance * width[..., None] ** 2)
    return dataclasses.replace(gaussians, scale=wider)


def colors_from_center(
    gaussians: Gaussians, camera: Camera, mean: Float[Array, "gaussians 3"]
) -> Gaussians:
    """Gaussians of one colour each, evaluated as in 3DGS: in the direction from the camera to their
    centres, at the frame's own time.

    Args:
        gaussians: The Gaussians.
        camera: The camera.
        mean: Centres of the Gaussians, in scene units.
    """
    eye = pose_at(camera.trajectory, camera.time).translation
    direction = jax.vmap(normalize)(mean - eye[None])
    color = radiance(jnp.moveaxis(gaussians.harmonics, 0, -1), direction.T).T
    return dataclasses.replace(gaussians, harmonics=constant_harmonics(color, 0))


def _distance(mean: Float[Array, "*times n 3"], camera: Camera) -> Float[Array, "*times n"]:
    pose = pose_at(camera.trajectory, camera.time)

    def distance(one: Float[Array, "3"]) -> Array:
        point = pose.inverse_apply(one)
        return jnp.abs(point[2]) if isinstance(camera.lens, Pinhole) else safe_norm(point)

    return jnp.vectorize(distance, signature="(k)->()")(mean)


def _pixel_angle(camera: Camera) -> Float[Array, ""]:
    """Radians across the pixel in the middle of the film, where lenses see best."""
    middle = jnp.asarray([camera.film.width / 2, camera.film.height / 2], camera.time.dtype)
    half = jnp.asarray([0.5, 0], camera.time.dtype)
    direction = camera.lens.direction
    return safe_norm(direction(middle + half) - direction(middle - half))
