"""Which numbers in [0, 1) make our camera take the samples that Blender took."""

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.aperture import Aperture
from gaussray.camera.film import Film, sample_offset


def of_film(film: Film, offset: np.ndarray) -> np.ndarray:
    """`u` whose `sample_offset` is the offset, in pixels, from the pixel's centre, per axis."""
    u = np.linspace(0, 1, 4097)
    both = jnp.asarray(np.stack([u, u], axis=1))
    table = np.asarray(jax.vmap(sample_offset, in_axes=(None, 0))(film, both), float)
    return np.interp(offset, table[:, 0], u)


def of_opening(aperture: Aperture, origin: np.ndarray, focus: np.ndarray) -> np.ndarray:
    """`u` whose ray leaves from `origin`, in camera axes, for the pixel that sees `focus`.

    Points outside of the opening get a `u` at its edge.
    """
    if aperture.focus == "sphere":
        origin = upright(origin, focus)
    radius, ratio = float(aperture.radius), float(aperture.ratio)
    x, y = origin[:, 0] * ratio / radius, -origin[:, 1] / radius
    angle = np.arctan2(y, x)
    if aperture.blades == 0:
        return square(np.hypot(x, y), angle / (2 * np.pi))
    # The edge that the point lies behind, its share of the way to it and along it.
    count, rotation = aperture.blades, float(aperture.rotation)
    edge = np.round((angle - rotation) * count / (2 * np.pi))
    middle = rotation + edge * 2 * np.pi / count
    distance = (x * np.cos(middle) + y * np.sin(middle)) / np.cos(np.pi / count)
    sideways = y * np.cos(middle) - x * np.sin(middle)
    way = sideways / (2 * np.sin(np.pi / count) * np.where(distance > 0, distance, 1)) + 0.5
    return square(distance, (edge + way) / count)


def upright(vector: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Vectors across `forward` after the shortest turn that takes it to the optical axis."""
    both = forward / np.linalg.norm(forward, axis=1, keepdims=True) + np.array([0, 0, 1])
    share = np.sum(vector * both, axis=1) / both[:, 2]
    return vector - share[:, None] * both


def square(distance: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Point of [0, 1]^2 that the concentric map takes to a distance and a share of a full turn."""
    distance = np.clip(distance, 0, 1)
    eighth = turn * 8 % 8
    quarter = np.floor((eighth + 1) / 2) % 4  # right, up, left, down
    lean = (eighth + 1) % 2 - 1
    sign = np.where(quarter < 2, distance, -distance)
    x = np.where(quarter % 2 == 0, sign, -sign * lean)
    y = np.where(quarter % 2 == 0, sign * lean, sign)
    return np.clip(0.5 + np.stack([x, y], axis=1) / 2, 0, 1 - 2**-24)


def unevenness(u: np.ndarray) -> float:
    """Largest difference between the share of samples below a value and the value itself."""
    count = len(u)
    ordered = np.sort(u, axis=0)
    steps = np.arange(count)[:, None] / count
    return float(np.max(np.maximum(ordered - steps, steps + 1 / count - ordered)))
