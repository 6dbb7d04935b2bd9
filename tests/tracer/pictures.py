"""A small picture through every lens, with aperture, rolling shutter and a moving camera."""

import jax
import jax.numpy as jnp
import numpy as np
from lenses import number, zoo
from scenes import OPTIONS, RAYS, Lines

from gaussray.camera.aperture import Aperture
from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.film import Film
from gaussray.camera.lens import FisheyePolynomial, KannalaBrandt, pinhole
from gaussray.camera.shutter import Shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.tracer.bundle import morton_tiles


SIDE = 8
LENSES = {
    "pinhole": pinhole(jnp.array([8.0, 8.5]), jnp.array([4.1, 3.9])),
    "distorted": pinhole(
        jnp.array([8.0, 8.5]),
        jnp.array([4.1, 3.9]),
        jnp.array([-0.2, 0.05, 0.01, -0.01, 0.0, 0.0, 0.0, 0.0]),
    ),
    "polynomial": FisheyePolynomial(
        jnp.array([0.0, -0.12, -1e-4, 0.0, 0.0]),
        jnp.array([36.0, 36.0]),
        jnp.array([8.0, 8.0]),
        jnp.array([0.01, 0.02]),
        number(3.9),
    ),
    "kannala": KannalaBrandt(
        jnp.array([2.2, 2.1]), jnp.array([4.1, 3.9]), jnp.array([0.01, 0, 0, 0]), number(1.9)
    ),
    **zoo(SIDE, SIDE),
}


shoot = jax.jit(camera_rays)


def seen_through(lens, radius=0.05):
    """One ray for every pixel, in the order of tiles; direction zero where the lens is black."""
    focus = "sphere" if LENSES[lens].sees_sideways else "plane"
    camera = Camera(
        Film(SIDE, SIDE, "box", 1.0),
        LENSES[lens],
        Aperture(number(radius), number(2.0), number(0.0), number(1.0), focus=focus),
        Shutter(number(-0.5), number(0.1), number(0.05)),
        Trajectory(
            jnp.array([-1.0, 2.0]),
            jnp.array([[0.9, 0.1, -0.3, 0.2], [0.9, 0.2, -0.3, 0.2]]),
            jnp.array([[0.0, 0.1, -0.2], [0.1, 0.0, -0.1]]),
        ),
        number(0.5),
    )
    index = morton_tiles(SIDE, SIDE, OPTIONS.bundle, OPTIONS.levels)
    pixel = jnp.asarray(np.stack([index % SIDE, index // SIDE], axis=-1), float)
    u = jnp.asarray(np.random.default_rng(5).uniform(size=(RAYS, 5)))
    seen = shoot(camera, pixel, u)
    return Lines(*(np.asarray(x) for x in (seen.origin, seen.direction, seen.time)))
