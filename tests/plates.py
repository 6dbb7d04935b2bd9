"""Flat plates of Gaussians that stand still, glide or turn, and cameras that film them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import toy

from gaussray.camera.camera import Camera
from gaussray.camera.lens import KannalaBrandt
from gaussray.camera.shutter import Shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.scene.bodies import Bodies
from gaussray.scene.deformation import initial_deformation
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics
from gaussray.scene.planes import initial_planes
from gaussray.scene.scene import Scene


# Distance of the plates from the camera, which looks along +z from the origin.
AWAY = 3.0
SIDE = 24
NOTHING = jax.tree.map(lambda x: x[:0], toy.gaussians([0, 0, 0], 0.1, [0, 0, 0]))


def plate(half: float, *, z: float = AWAY, x: float = 0.0, spacing: float = 0.2) -> Gaussians:
    """A square of overlapping discs that faces the camera."""
    line = np.arange(-half, half + spacing / 2, spacing)
    place = np.stack([*np.meshgrid(line + x, line), np.full((len(line),) * 2, z)], axis=-1)
    place = toy.single(place.reshape(-1, 3))
    count = len(place)
    scale = jnp.broadcast_to(toy.single([0.75 * spacing, 0.75 * spacing, 0.01]), (count, 3))
    quat = jnp.broadcast_to(toy.single([1, 0, 0, 0]), (count, 4))
    opacity = jnp.full(count, 0.9, jnp.float32)
    return Gaussians(place, quat, scale, opacity, constant_harmonics(jnp.full((count, 3), 0.5), 0))


def moved(plate: Gaussians, *, velocity=(0, 0, 0), rate: float = 0.0, still=NOTHING) -> Scene:
    """A scene in which a plate glides, and turns about the vertical through its middle, by so many
    radians per unit of time; it is as built at time 0."""
    time = np.linspace(-0.5, 1.5, 21)
    pivot = np.asarray(plate.mean, np.float64).mean(axis=0)
    half = rate * time / 2
    turn = np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half], axis=-1)
    bodies = Bodies(
        toy.single(pivot)[None],
        jnp.full(1, 100, jnp.float32),
        toy.single(time),
        toy.single(time[:, None] * velocity)[None],
        toy.single(turn)[None],
    )
    planes = initial_planes(
        jax.random.key(0), toy.single([-5] * 3), toy.single([5] * 3), (0.0, 1.0), sides=(4,),
        instants=3, channels=4,
    )  # fmt: skip
    field = initial_deformation(jax.random.key(1), planes, bodies, width=8)
    field = jax.tree.map(lambda x: x.astype(jnp.float32), field)
    return Scene(still, plate, field, toy.single([0, 1]))


def camera(time: float, *, readout=0.0, fisheye=False, velocity=None, exposure=0.0) -> Camera:
    """A camera at the origin at time 0, that reads its rows in so much time and may move."""
    made = toy.camera(width=SIDE, height=SIDE, time=time)
    step = readout / (SIDE - 1)
    shutter = Shutter(*map(toy.single, (-readout / 2, step, exposure)))
    knots = np.array([-1.0, 2.0]) if velocity is not None else np.zeros(1)
    place = knots[:, None] * (0, 0, 0) if velocity is None else knots[:, None] * velocity
    turn = jnp.broadcast_to(toy.single([1, 0, 0, 0]), (len(knots), 4))
    path = Trajectory(toy.single(knots), turn, toy.single(place))
    lens = made.lens
    if fisheye:
        middle = toy.single([SIDE / 2] * 2)
        lens = KannalaBrandt(lens.focal, middle, jnp.zeros(4, jnp.float32), toy.single(1.2))
    return dataclasses.replace(made, lens=lens, shutter=shutter, trajectory=path)
