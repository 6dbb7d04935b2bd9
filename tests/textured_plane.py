"""A textured plane, seen by synthetic cameras without any renderer."""

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.aperture import no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import Fisheye, pinhole
from gaussray.camera.shutter import global_shutter
from gaussray.camera.trajectory import static_trajectory
from gaussray.geometry import RigidTransform, quaternion
from gaussray.reconstruct.initialize.stereo.options import StereoOptions


SIZE = 48
# Quick to compile, and enough for what is smooth.
QUICK = StereoOptions(neighbours=4, depths=32, tilts=(), modes=2, rounds=1, confirm=2)
# The plane: normal and distance from the origin.
NORMAL, OFFSET = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0]), 0.1


def texture(point):
    """Colours in 0..1 of places on the plane; aperiodic over what the cameras see."""
    phase = point @ np.array([[9.0, 2.0, 5.0, 13.0], [3.0, 11.0, -7.0, 4.0], [1.0, 2.0, 3.0, -2.0]])
    a, b, c, d = np.sin(np.moveaxis(phase, -1, 0))
    mix = np.stack([a + b + a * d, b - c + c * d, d + c * a], axis=-1)
    return 0.5 + 0.15 * mix


def perspective():
    focal, center = jnp.asarray([1.1 * SIZE] * 2), jnp.asarray([SIZE / 2] * 2)
    return pinhole(focal.astype(float), center.astype(float))


def fisheye():
    """Equidistant, 150 degrees from corner to corner."""
    half = np.radians(75)
    focal = SIZE / np.sqrt(2) / half
    return Fisheye(
        jnp.asarray([focal, focal]), jnp.asarray([SIZE / 2] * 2), jnp.asarray(1.05 * half)
    )


def looking(place, target):
    """World from camera: +z towards the target, +y roughly along the world's -y."""
    z = (target - place) / np.linalg.norm(target - place)
    x = np.cross([0.0, -1.0, 0.0], z)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    return RigidTransform(quaternion(jnp.asarray(rotation)), jnp.asarray(place))


def rig(lens, places):
    """Cameras of one lens at these places, stacked, that look at the origin."""
    zero = jnp.asarray(0.0)
    shutter = global_shutter()
    cameras = [
        Camera(
            Film(SIZE, SIZE, "center"),
            lens,
            no_aperture(),
            shutter,
            static_trajectory(looking(np.asarray(place), np.zeros(3))),
            zero,
        )
        for place in places
    ]
    return jax.tree.map(lambda *x: jnp.stack(x), *cameras)


PLACES = [
    (0.0, 0.0, -3.0),
    (0.7, 0.1, -3.0),
    (-0.7, 0.2, -2.9),
    (0.1, 0.7, -3.1),
    (0.0, -0.7, -3.0),
]


def places_on_plane(cameras):
    """Where the rays of all pixels' centres meet the plane [cameras, h, w, 3], and how far away."""
    column, row = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    pixel = jnp.asarray(np.stack([column.ravel(), row.ravel()], axis=-1))
    places, distances = [], []
    for k in range(len(cameras.time)):
        camera = jax.tree.map(lambda x, k=k: x[k], cameras)
        pose = RigidTransform(camera.trajectory.quat[0], camera.trajectory.translation[0])
        ray = np.asarray(jax.vmap(lambda p, c=camera: c.lens.direction(p))(pixel))
        ray = np.asarray(jax.vmap(pose.rotate)(jnp.asarray(ray)))
        origin = np.asarray(pose.translation)
        away = (OFFSET - origin @ NORMAL) / np.maximum(ray @ NORMAL, 1e-3)
        places.append((origin + away[:, None] * ray).reshape(SIZE, SIZE, 3))
        distances.append(away.reshape(SIZE, SIZE))
    return np.stack(places), np.stack(distances)


def seen(cameras):
    """The pictures of the plane, by intersecting the rays of the pixels' centres."""
    places, away = places_on_plane(cameras)
    # Far off the texture is finer than a pixel.
    return np.where(away[..., None] < 8, texture(places), 0.5)
