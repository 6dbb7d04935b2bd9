"""Scenes at the edge: what is in them, and the rays that look."""

import jax.numpy as jnp
import numpy as np

from benchmarks.problem import room, room_rays
from gaussray.camera.rays import Rays
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics
from gaussray.tracer.bundle import morton_tiles


def single(x):
    """In the precision that is tried."""
    return jnp.asarray(x, jnp.float32)


def gaussians(mean, scale, opacity, dice) -> Gaussians:
    """Gaussians of random turn and colour."""
    count = len(mean)
    color = single(dice.uniform(size=(count, 3)))
    scale = np.broadcast_to(
        np.reshape(scale, (-1, 1)) if np.ndim(scale) == 1 else scale, mean.shape
    )
    opacity = np.broadcast_to(opacity, count)
    return Gaussians(
        single(mean), single(dice.normal(size=(count, 4))), single(scale), single(opacity),
        constant_harmonics(color, 0),
    )  # fmt: skip


def looking(side, *, origin=(0.0, 0, 0), wide=0.5) -> Rays:
    """A pinhole that looks along +z: rays in the order of the tiles, sides up to `wide` aside."""
    order = morton_tiles(side, side, 8, 1)
    order = order[order >= 0]
    x, y = ((order % side, order // side) - np.array(side / 2 - 0.5)) * (2 * wide / side)
    direction = np.stack([x, y, np.ones(len(x))], axis=-1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    place = np.broadcast_to(origin, direction.shape)
    return Rays(single(place), single(direction), jnp.zeros(len(order), jnp.float32))


def parallel(side, wide) -> Rays:
    """Rays along +z, side by side."""
    order = morton_tiles(side, side, 8, 1)
    order = order[order >= 0]
    x, y = ((order % side, order // side) - np.array(side / 2 - 0.5)) * (2 * wide / side)
    place = np.stack([x, y, np.zeros(len(x))], axis=-1)
    ahead = np.broadcast_to([0.0, 0, 1], place.shape)
    return Rays(single(place), single(ahead), jnp.zeros(len(order), jnp.float32))


def many(count, side):
    """A room of so many Gaussians."""
    order = morton_tiles(side, side, 8, 1)
    return room(count), room_rays(side, order[order >= 0])


def millimetres_in_kilometres(count, side):
    """Heaps of Gaussians of a millimetre, at 0, 1, 10, 100 and 1000 m, each before a wall of
    Gaussians of 100 m a kilometre behind it; the camera is 10 cm from the farthest heap."""
    dice = np.random.default_rng(1)
    place = np.array([0, 1, 10, 100, 1000.0])[dice.integers(5, size=count)]
    mean = place[:, None] * [0.6, 0, 0.8] + 0.02 * dice.normal(size=(count, 3))
    wall = np.stack([*dice.uniform(-1500, 1500, (2, 200)), np.full(200, 2000.0)], axis=-1)
    scale = np.concatenate([1e-3 * np.exp(dice.normal(0, 0.3, count)), np.full(200, 100.0)])
    eye = np.array([600, 0, 800 - 0.1])
    opacity = dice.uniform(0.1, 1, count + 200)
    return gaussians(np.concatenate([mean, wall]), scale, opacity, dice), looking(side, origin=eye)


def galaxy(count, side, *, away):
    """A disc of Gaussians at 1e6: of radius 1e4 and seen from 1e6 away, or of unit Gaussians within
    100, with the camera among them."""
    dice = np.random.default_rng(2)
    radius, angle = np.sqrt(dice.uniform(size=count)), dice.uniform(0, 2 * np.pi, count)
    radius = radius * (1e4 if away else 100)
    flat = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1) * radius[:, None]
    mean = flat + np.array([0, 0, 1e6]) + 30 * dice.normal(size=(count, 3))
    # From far away what is to be seen has to be larger than what float32 tells apart there.
    size = np.exp(dice.normal(0, 0.5, count)) * (100 if away else 1)
    shown = gaussians(mean, size, dice.uniform(0.1, 1, count), dice)
    near = (20.0, 0, 1e6 - 60)
    return shown, looking(side, wide=0.01) if away else looking(side, origin=near)


def layers(count, side):
    """Discs one behind the other, through which 1e-32 of the light comes."""
    dice = np.random.default_rng(3)
    mean = np.stack([0 * np.arange(16), 0 * np.arange(16), 2.0 + np.arange(16)], axis=-1)
    return gaussians(mean, np.full(16, 50.0), 0.99, dice), looking(side)


def coplanar(count, side):
    """A thousand equal spheres in one plane, all at the same distance along parallel rays. Their
    reach begins at one distance too, so that all backends order them by their numbers."""
    dice = np.random.default_rng(4)
    mean = np.append(dice.uniform(-1, 1, (1000, 2)), np.full((1000, 1), 4.0), axis=1)
    shown = gaussians(mean, np.full(1000, 0.1), 0.5, dice)
    upright = jnp.tile(single([1.0, 0, 0, 0]), (1000, 1))
    return Gaussians(shown.mean, upright, shown.scale, shown.opacity, shown.harmonics), parallel(
        side, 1.0
    )
