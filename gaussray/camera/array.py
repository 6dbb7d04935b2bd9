"""The training cameras of a capture: index of each frame's camera, scales of corrections, times."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.camera.camera import Camera
from gaussray.camera.lens import AbstractLens
from gaussray.camera.shutter import time_window
from gaussray.runtime.stored_programs import kept_jit


class CameraSet(eqx.Module):
    """The training cameras of a capture.

    Args:
        owner: index of the camera of each frame.
        lens: number of the lens of each camera; where lenses are refined, equal ones have one.
        position: mean position of each camera, in scene units.
        pixel: angle between neighbouring pixels in the middle of each camera's picture, in radians.
        extent: radius of the cameras' positions in scene units, the length unit of learning rates.
        interval: median time between two timestamps, in the capture's unit.
        times: the timestamps, increasing.
        pose_projector: projector onto the pose corrections of all cameras (`Corrections.pose`,
            flattened) that are not a common similarity transform.
        earlier: the longest time by which a row's exposure precedes its frame's timestamp, in the
            capture's unit.
        later: the longest time by which it follows the timestamp.
    """

    owner: Int[Array, " frames"]
    lens: Int[Array, " cameras"]
    position: Float[Array, "cameras 3"]
    pixel: Float[Array, " cameras"]
    extent: Float[Array, ""]
    interval: Float[Array, ""]
    times: Float[Array, " times"]
    pose_projector: Float[Array, "poses poses"]
    earlier: float = eqx.field(static=True)
    later: float = eqx.field(static=True)

    @property
    def count(self) -> int:
        """The number of cameras."""
        return self.pose_projector.shape[0] // 6


def camera_set(
    owner: Int[np.ndarray, " frames"],
    camera: Camera,
    *,
    extent: float,
    refine: tuple[str, ...] = (),
) -> CameraSet:
    """Build the set of training cameras.

    Args:
        owner: index of the camera of each frame.
        camera: the stacked cameras of the frames.
        extent: radius of the cameras' positions.
        refine: what is refined of the cameras (`corrections.REFINABLE`). With shutter or offset,
            `earlier` and `later` leave room for the corrections.
    """
    dtype, film = camera.time.dtype, camera.film
    position = np.asarray(camera.trajectory.translation, np.float64).mean(axis=1)
    position = np.stack([position[owner == i].mean(axis=0) for i in range(owner.max() + 1)])
    _, first_frame = np.unique(owner, return_index=True)
    first = jax.tree.map(lambda x: np.asarray(x)[first_frame], camera)
    pixel = _pixel_angle(jax.tree.map(jnp.asarray, first))
    # Only lenses that are refined are compared: tables of rays are large.
    keys = [lens_key(first.lens, k) if "lens" in refine else k for k in range(len(first_frame))]
    numbers = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    lens = [numbers[key] for key in keys]
    times = np.unique(np.asarray(camera.time))
    interval = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    earliest, latest = time_window(camera.shutter, (film.width, film.height))
    room = 1.5 if "shutter" in refine else 1.0
    delay = interval / 2 if "offset" in refine else 0.0
    return CameraSet(
        jnp.asarray(owner, jnp.int32),
        jnp.asarray(lens, jnp.int32),
        jnp.asarray(position, dtype),
        pixel,
        jnp.asarray(extent, dtype),
        jnp.asarray(interval, dtype),
        jnp.asarray(times, dtype),
        jnp.asarray(_without_similarity(position / extent), dtype),
        earlier=delay - room * earliest,
        later=delay + room * latest,
    )


def lens_key(lens: AbstractLens, *index: int) -> bytes:
    """All numbers of a lens: those of equal lenses are equal.

    Args:
        lens: a lens, or a stack of them.
        index: number of the lens in the stack; none for a single one.
    """
    return b"".join(np.asarray(x)[index].tobytes() for x in jax.tree.leaves(lens))


def pixel_spacing(
    cameras: CameraSet, mean: Float[Array, "gaussians 3"]
) -> Float[Array, " gaussians"]:
    """Distance of neighbouring pixels at each Gaussian, in the camera that resolves it best.

    Args:
        cameras: the cameras.
        mean: centres of the Gaussians, in scene units.

    Returns:
        Distances in scene units.
    """

    def smallest(point: Float[Array, "3"]) -> Float[Array, ""]:
        difference = cameras.position - point[None]
        return jnp.min(cameras.pixel * jnp.sqrt(jnp.sum(difference * difference, axis=-1)))

    return jax.vmap(smallest)(mean)


def nearest_camera_distance(
    cameras: CameraSet, mean: Float[Array, "gaussians 3"]
) -> Float[Array, " gaussians"]:
    """Distance of each Gaussian from the camera nearest to it, in scene units.

    Args:
        cameras: the cameras, each at its mean position.
        mean: centres of the Gaussians, in scene units.
    """

    def nearest(point: Float[Array, "3"]) -> Float[Array, ""]:
        difference = cameras.position - point[None]
        return jnp.sqrt(jnp.min(jnp.sum(difference * difference, axis=-1)))

    return jax.vmap(nearest)(mean)


def rays_per_pixel(camera: Camera) -> int:
    """Rays per pixel in training: 1 for sharp pictures, 4 with depth of field or motion blur."""
    blur = camera.aperture.radius, camera.shutter.exposure
    return 4 if any(np.any(np.asarray(x)) for x in blur) else 1


@kept_jit
def _pixel_angle(cameras: Camera) -> Float[Array, " cameras"]:
    """Angle between the rays of neighbouring pixels in the middle of the picture, in radians."""
    film = cameras.film
    dtype = cameras.time.dtype
    pair = jnp.asarray([[film.width / 2 + x, film.height / 2] for x in (-0.5, 0.5)], dtype)

    def one(camera: Camera) -> Float[Array, ""]:
        left, right = (camera.lens.direction(pixel) for pixel in pair)
        return jnp.sqrt(jnp.sum((right - left) ** 2))

    return jax.vmap(one)(cameras)


def _without_similarity(
    position: Float[np.ndarray, "cameras 3"],
) -> Float[np.ndarray, "poses poses"]:
    """Projector that removes small rotations, translations and scalings of the whole set."""
    position = position - position.mean(axis=0, keepdims=True)
    axes = np.eye(3)
    whole = np.zeros((len(position), 6, 7))
    for k in range(3):
        whole[:, k, k] = 1
        whole[:, 3:, k] = np.cross(axes[k][None], position)
        whole[:, 3 + k, 3 + k] = 1
    whole[:, 3:, 6] = position
    basis, size, _ = np.linalg.svd(whole.reshape(-1, 7), full_matrices=False)
    basis = basis[:, size > 1e-6 * size[0]]
    return np.eye(len(basis)) - basis @ basis.T
