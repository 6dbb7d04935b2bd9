"""What rasterisers of Gaussians do to a picture and rays do not, for models fitted through them."""

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


def dilated(gaussians: Gaussians, camera: Camera, variance: float) -> Gaussians:
    """Gaussians that are wider on the screen by a `variance` in square pixels (3DGS: 0.3).

    scale' = sqrt(scale^2 + variance w^2) on every axis, w the width of a pixel at the Gaussian's
    distance: the depth along the axis for a pinhole, else the distance to the lens, times the angle
    of the middle pixel. What 3DGS adds on the screen, to first order in the Gaussian's size over
    its distance; as there, opacities stay. Scales [..., n, 3] may have leading axes of times.
    """
    width = _distance(gaussians.mean, camera) * _pixel_angle(camera)
    wider = jnp.sqrt(gaussians.scale**2 + variance * width[..., None] ** 2)
    return dataclasses.replace(gaussians, scale=wider)


def seen_from_center(
    gaussians: Gaussians, camera: Camera, mean: Float[Array, "gaussians 3"]
) -> Gaussians:
    """Gaussians of one colour each: that in the direction from the camera's place, at the frame's
    own time, to their `mean`, as 3DGS evaluates harmonics."""
    eye = pose_at(camera.trajectory, camera.time).translation
    direction = jax.vmap(normalize)(mean - eye[None])
    color = radiance(jnp.moveaxis(gaussians.harmonics, 0, -1), direction.T).T
    return dataclasses.replace(gaussians, harmonics=constant_harmonics(color, 0))


def _distance(mean: Float[Array, "*times n 3"], camera: Camera) -> Float[Array, "*times n"]:
    pose = pose_at(camera.trajectory, camera.time)

    def distance(one: Float[Array, "3"]) -> Array:
        seen = pose.inverse_apply(one)
        return jnp.abs(seen[2]) if isinstance(camera.lens, Pinhole) else safe_norm(seen)

    return jnp.vectorize(distance, signature="(k)->()")(mean)


def _pixel_angle(camera: Camera) -> Float[Array, ""]:
    """Radians across the pixel in the middle of the film, where lenses see best."""
    middle = jnp.asarray([camera.film.width / 2, camera.film.height / 2], camera.time.dtype)
    half = jnp.asarray([0.5, 0], camera.time.dtype)
    direction = camera.lens.direction
    return safe_norm(direction(middle + half) - direction(middle - half))
