"""The set of training cameras: owner of each frame, units of corrections, span of times."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import time_window


class CameraSet(eqx.Module):
    """The training cameras of a capture.

    Args:
        owner: number of the camera of each frame.
        place: mean position of each camera.
        pixel: angle between neighbouring pixels in the middle of each camera's picture, in radians.
        extent: radius of the cameras' positions, the length unit of learning rates.
        interval: time between two timestamps, the median.
        times: the timestamps, increasing.
        free: projector onto the pose corrections of all cameras (`Corrections.pose`, flattened)
            that are not a common similarity transform.
        earlier: the longest time between a row's exposure and its frame's timestamp, before it.
        later: the same after the timestamp, in the capture's unit of time.
    """

    owner: Int[Array, " frames"]
    place: Float[Array, "cameras 3"]
    pixel: Float[Array, " cameras"]
    extent: Float[Array, ""]
    interval: Float[Array, ""]
    times: Float[Array, " times"]
    free: Float[Array, "poses poses"]
    earlier: float = eqx.field(static=True)
    later: float = eqx.field(static=True)

    @property
    def count(self) -> int:
        """The number of cameras."""
        return self.free.shape[0] // 6


def camera_set(
    owner: Int[np.ndarray, " frames"],
    camera: Camera,
    *,
    extent: float,
    refine: tuple[str, ...] = (),
) -> CameraSet:
    """The set of training cameras.

    Args:
        owner: number of the camera of each frame.
        camera: the stacked cameras of the frames.
        extent: radius of the cameras' positions.
        refine: what is refined of the cameras. With shutter or offset, `earlier` and `later` leave
            room for it.
    """
    dtype, film = camera.time.dtype, camera.film
    place = np.asarray(camera.trajectory.translation, np.float64).mean(axis=1)
    place = np.stack([place[owner == i].mean(axis=0) for i in range(owner.max() + 1)])
    _, first_frame = np.unique(owner, return_index=True)
    pixel = _pixel_angle(jax.tree.map(lambda x: x[first_frame], camera))
    times = np.unique(np.asarray(camera.time))
    interval = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    first, last = time_window(camera.shutter, (film.width, film.height))
    room = 1.5 if "shutter" in refine else 1.0
    delay = interval / 2 if "offset" in refine else 0.0
    return CameraSet(
        jnp.asarray(owner, jnp.int32),
        jnp.asarray(place, dtype),
        pixel,
        jnp.asarray(extent, dtype),
        jnp.asarray(interval, dtype),
        jnp.asarray(times, dtype),
        jnp.asarray(_free(place / extent), dtype),
        earlier=delay - room * first,
        later=delay + room * last,
    )


def resolved(cameras: CameraSet, mean: Float[Array, "gaussians 3"]) -> Float[Array, " gaussians"]:
    """Distance of neighbouring pixels at each Gaussian, in the camera that resolves it best."""

    def nearest(place: Float[Array, "3"]) -> Float[Array, ""]:
        away = cameras.place - place[None]
        return jnp.min(cameras.pixel * jnp.sqrt(jnp.sum(away * away, axis=-1)))

    return jax.vmap(nearest)(mean)


def nearest_camera(
    cameras: CameraSet, mean: Float[Array, "gaussians 3"]
) -> Float[Array, " gaussians"]:
    """Distance of each Gaussian from the camera that is nearest to it."""

    def nearest(place: Float[Array, "3"]) -> Float[Array, ""]:
        away = cameras.place - place[None]
        return jnp.sqrt(jnp.min(jnp.sum(away * away, axis=-1)))

    return jax.vmap(nearest)(mean)


def rays_per_pixel(camera: Camera) -> int:
    """Rays per pixel in training: 1 for sharp pictures, 4 with depth of field or motion blur."""
    blur = camera.aperture.radius, camera.shutter.exposure
    return 4 if any(np.any(np.asarray(x)) for x in blur) else 1


@jax.jit
def _pixel_angle(cameras: Camera) -> Float[Array, " cameras"]:
    """Angle between the rays of neighbouring pixels in the middle of the picture, in radians."""
    film = cameras.film
    dtype = cameras.time.dtype
    pair = jnp.asarray([[film.width / 2 + x, film.height / 2] for x in (-0.5, 0.5)], dtype)

    def one(camera: Camera) -> Float[Array, ""]:
        left, right = (camera.lens.direction(place) for place in pair)
        return jnp.sqrt(jnp.sum((right - left) ** 2))

    return jax.vmap(one)(cameras)


def _free(place: Float[np.ndarray, "cameras 3"]) -> Float[np.ndarray, "poses poses"]:
    """Projector that removes small rotations, translations and scalings of the whole set."""
    place = place - place.mean(axis=0, keepdims=True)
    axes = np.eye(3)
    whole = np.zeros((len(place), 6, 7))
    for k in range(3):
        whole[:, k, k] = 1
        whole[:, 3:, k] = np.cross(axes[k][None], place)
        whole[:, 3 + k, 3 + k] = 1
    whole[:, 3:, 6] = place
    basis, size, _ = np.linalg.svd(whole.reshape(-1, 7), full_matrices=False)
    basis = basis[:, size > 1e-6 * size[0]]
    return np.eye(len(basis)) - basis @ basis.T
