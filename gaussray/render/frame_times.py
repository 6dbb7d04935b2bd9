"""The times of a frame: first and last of its rays, and those of the scene's key states."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.shutter import first_and_last_pixels
from gaussray.render.parts import Part


def frame_span(camera: Camera, part: Part) -> Float[Array, "2"]:
    """First and last time of the rays of a frame, in the capture's unit.

    Args:
        camera: the camera.
        part: the pixels, with the segment that they show.
    """
    time = _extreme_times(camera, part)
    return jnp.stack([jnp.min(time), jnp.max(time)])


def key_times(camera: Camera, part: Part, keys: int) -> Float[Array, " keys"]:
    """Times of the key states of a frame, in the capture's unit.

    Args:
        camera: the camera.
        part: the pixels.
        keys: number of key states; 0 is one, at the time of the part's row.
    """
    if not keys:
        place = jnp.stack([jnp.zeros_like(part.row), part.row])
        u = jnp.full((1, 5), 0.5, camera.time.dtype)
        return jnp.clip(camera_rays(camera, place[None], u).time, *_time_limits(part))
    return even_key_times(frame_span(camera, part), keys)


def even_key_times(span: Float[Array, "2"], keys: int) -> Float[Array, " keys"]:
    """Key times at even intervals.

    Args:
        span: first and last time of a frame.
        keys: number of key times; a single one is the middle.
    """
    if keys == 1:
        return jnp.mean(span, keepdims=True)
    return jnp.linspace(span[0], span[1], keys, dtype=span.dtype)


def _extreme_times(camera: Camera, part: Part) -> Float[Array, " rays"]:
    """Times of rays among which are the first and the last of a frame."""
    dtype = camera.time.dtype
    pixel = first_and_last_pixels(camera.shutter, (camera.film.width, camera.film.height))
    place = jnp.asarray(np.repeat(pixel, 2, axis=0), dtype)
    u = np.full((len(place), 5), 0.5)
    u[:, 4] = np.tile([0, 1], len(pixel))
    return jnp.clip(camera_rays(camera, place, jnp.asarray(u, dtype)).time, *_time_limits(part))


def _time_limits(part: Part) -> tuple[Array | None, Array | None]:
    """The times between which a segment shows the frame; None where it shows all of it."""
    return (None, None) if part.share is None else (part.share.span[0], part.share.span[1])
