"""A photograph by a known camera, for tests of structure-from-motion projects."""

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from gaussray.camera.camera import project
from gaussray.dataset.images import write_image


# Single precision through lens and pose, in pixels.
PIXELS = 2e-3
W, H = 64, 48
# Rotation, camera to world, of a camera with axes +x right, +y down, +z forward; and its place.
TURN = Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix()
PLACE = np.array([0.5, -1, 2])
# The rotation and translation that take places in the world to the camera.
TO_CAMERA, SHIFT = TURN.T, -TURN.T @ PLACE


def write_picture(path, width=W, height=H):
    path.parent.mkdir(parents=True, exist_ok=True)
    kind = np.float32 if path.suffix == ".exr" else np.uint8
    write_image(path, np.full((height, width, 3), 1, kind))


def seen_points(turn=TURN, place=PLACE):
    """Points before a camera, in the world and in the camera's axes."""
    own = 3 * np.random.default_rng(0).uniform((-0.6, -0.4, 1), (0.6, 0.4, 1), (20, 3))
    return own @ turn.T + place, own


def pixels(view, world):
    return np.array([project(view.camera, jnp.asarray(x, jnp.float32)) for x in world])


def distorted(own, k1=0, k2=0, k3=0, p1=0, p2=0):
    """Image points, in focal lengths, of Brown's lens."""
    x, y = (own[:, :2] / own[:, 2:]).T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y**2)
    return np.stack([u, v], axis=1)


def fisheye(own, *k):
    """Image points, in focal lengths, of a fisheye r = theta (1 + k1 theta^2 + ...)."""
    flat = np.linalg.norm(own[:, :2], axis=1)
    theta = np.arctan2(flat, own[:, 2])
    radius = theta * (1 + sum(k[i] * theta ** (2 * i + 2) for i in range(len(k))))
    return own[:, :2] * (radius / flat)[:, None]


def sphere(own):
    """Longitude and latitude downwards, in turns."""
    longitude = np.arctan2(own[:, 0], own[:, 2])
    latitude = np.arctan2(own[:, 1], np.linalg.norm(own[:, [0, 2]], axis=1))
    return np.stack([longitude, latitude], axis=1) / (2 * np.pi)
