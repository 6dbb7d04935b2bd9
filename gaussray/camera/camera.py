"""A camera is its film, lens, aperture, shutter and trajectory, in this order."""

import equinox as eqx
import jax
from jaxtyping import Array, Float

from gaussray.camera.aperture import Aperture, focused, thin_lens, transmitted
from gaussray.camera.film import Film, sample_offset
from gaussray.camera.lens import AbstractLens
from gaussray.camera.rays import Rays
from gaussray.camera.shutter import Shutter, sample_time
from gaussray.camera.trajectory import Trajectory, pose_at


class Camera(eqx.Module):
    """Everything between the scene and one picture taken at `time`."""

    film: Film
    lens: AbstractLens
    aperture: Aperture
    shutter: Shutter
    trajectory: Trajectory
    time: Float[Array, ""]


def camera_ray(camera: Camera, pixel: Float[Array, "2"], u: Float[Array, "5"]) -> Rays:
    """The ray of one sample of the pixel with index (column, row), in the world.

    `u` in [0, 1) is film x, film y, lens x, lens y, shutter; 1/2 everywhere is the chief ray of the
    pixel's centre in the middle of its exposure.
    """
    film = camera.film
    time = sample_time(camera.shutter, pixel, (film.width, film.height), camera.time, u[4])
    aperture = focused(camera.aperture, time)
    chief = camera.lens.direction(pixel + 0.5 + sample_offset(film, u[:2]))
    origin, direction = thin_lens(aperture, chief, u[2:4])
    weight = transmitted(aperture, chief, u[2:4])
    world_from_camera = pose_at(camera.trajectory, time)
    return Rays(world_from_camera.apply(origin), world_from_camera.rotate(direction), time, weight)


def camera_rays(camera: Camera, pixel: Float[Array, "rays 2"], u: Float[Array, "rays 5"]) -> Rays:
    """`camera_ray` for many samples."""
    return jax.vmap(camera_ray, in_axes=(None, 0, 0))(camera, pixel, u)


def project(camera: Camera, point: Float[Array, "3"]) -> Float[Array, "2"]:
    """Pixel of a point of the world, seen from the camera's pose at the frame's own time.

    A rolling shutter and the aperture are left out. NaN where the point is not imaged.
    """
    world_from_camera = pose_at(camera.trajectory, camera.time)
    return camera.lens.project(world_from_camera.inverse_apply(point))
