"""The ground-truth camera without effects: an ideal pinhole with an instantaneous exposure."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.aperture import no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.lens import AbstractLens, Division, Pinhole, pinhole
from gaussray.camera.lens.correctable import ParametricLens
from gaussray.camera.shutter import Shutter, time_window
from gaussray.camera.trajectory import pose_at, static_trajectory


# Largest field of view of an ideal pinhole, in degrees: at 170 the edge is enlarged 130 times.
WIDEST = 170.0
# Angles come in single precision, which this factor allows for.
_ROUNDING = 1 + 1e-4


def ideal_pinhole_of(camera: Camera) -> Camera:
    """The camera without effects: an ideal pinhole with an instantaneous exposure (label `sharp`).

    All rows are exposed at the middle of the frame's readout, from the pose of that moment. A
    perspective lens keeps its focal lengths and center. Another lens becomes a pinhole of the same
    horizontal field of view, the wider half of it on both sides, with pixels of the same shape. On
    the host.

    Raises:
        ValueError: The field of view is wider than `WIDEST` degrees.
    """
    camera = jax.device_get(camera)
    dtype, film = camera.time.dtype, camera.film
    begin, end = time_window(camera.shutter, (film.width, film.height))
    time = jnp.asarray(camera.time + (begin + end) / 2, dtype)
    zero = jnp.zeros((), dtype)
    aperture = jax.tree.map(lambda x: x.astype(dtype), no_aperture())
    return Camera(
        film,
        _perspective(camera, dtype),
        aperture,
        Shutter(zero, zero, zero),
        static_trajectory(pose_at(jax.tree.map(jnp.asarray, camera.trajectory), time)),
        time,
    )


def _perspective(camera: Camera, dtype) -> AbstractLens:
    lens, film = camera.lens, camera.film
    if isinstance(lens, Pinhole | Division):
        return pinhole(jnp.asarray(lens.focal), jnp.asarray(lens.center))
    half = _half_angle(lens, film.width, film.height, dtype)
    if not 0 < half <= np.deg2rad(WIDEST / 2) * _ROUNDING:
        raise ValueError(
            f"labels: sharp needs a picture of at most {WIDEST:g} degrees across, which an ideal "
            f"pinhole can show, got {np.rad2deg(2 * half):.4g}. Leave sharp out, or take a lens "
            "with a narrower lens.fov."
        )
    across = film.width / 2 / np.tan(half)
    x, y = np.asarray(lens.focal, float) if isinstance(lens, ParametricLens) else (1, 1)
    center = jnp.asarray([film.width / 2, film.height / 2], dtype)
    return pinhole(jnp.asarray([across, across * y / x], dtype), center)


def _half_angle(lens: AbstractLens, width: int, height: int, dtype) -> float:
    """Largest angle from the camera's axis, in radians, along the picture's middle row."""
    # An edge at the lens's rim may be black by rounding; what is just inside of it is not.
    inside = width * np.array([1e-6, 1 - 1e-6])
    column = np.concatenate([np.linspace(0, width, 4 * width + 1), inside])
    row = jnp.asarray(np.stack([column, np.full_like(column, height / 2)], axis=-1), dtype)
    direction: Float[Array, "places 3"] = jax.vmap(jax.tree.map(jnp.asarray, lens).direction)(row)
    directions = np.asarray(direction, np.float64)
    angle = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
    return float(np.max(angle, where=np.any(directions != 0, axis=-1), initial=0))
