"""What is measured: a generated room, the same with things that move in it, and its cameras."""

from collections.abc import Iterator
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from gaussray.camera.aperture import Aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import AbstractLens, FisheyePolynomial, pinhole
from gaussray.camera.rays import Rays
from gaussray.camera.shutter import Shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.geometry import quaternion
from gaussray.scene.bodies import Bodies
from gaussray.scene.deformation import Deformation, Layer, initial_deformation
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics
from gaussray.scene.planes import initial_planes
from gaussray.scene.scene import Scene


# The capture that comes with the repository.
SAMPLE = Path(__file__).resolve().parents[1] / "experiments" / "quickstart" / "capture"
# Where the cameras stand and what they look at.
EYE, TARGET = np.array([2.4, -2.4, 0.6]), np.array([0, 0, -0.4])
# Instants of the generated capture, which lasts from 0 to 1.
INSTANTS = 8


def room(count: int, seed: int = 0) -> Gaussians:
    """A 6 x 6 x 3 room: two thirds of the Gaussians on its walls, one third on twelve spheres.

    Log-normal scales with one thin axis, bimodal opacity, random colours: the worst case for the
    order of hits.
    """
    dice = np.random.default_rng(seed)
    on_walls, on_spheres = count - count // 3, count // 3
    size = np.array([6.0, 6.0, 3.0])
    area = np.array([18, 18, 18, 18, 36, 36.0])
    wall = dice.choice(6, on_walls, p=area / area.sum())
    axis, side = wall // 2, np.where(wall % 2, 1.0, -1.0)
    rows = np.arange(on_walls)
    flat = dice.uniform(-0.5, 0.5, (on_walls, 3)) * size
    flat[rows, axis] = side * size[axis] / 2
    spacing = 0.6 * np.sqrt(area.sum() / max(on_walls, 1))
    flat_scale = np.exp(dice.normal(np.log(spacing), 0.5, (on_walls, 3)))
    flat_scale[rows, axis] = 0.004
    flat_quat = np.eye(4)[np.zeros(on_walls, int)] + dice.normal(0, 0.02, (on_walls, 4))
    center = dice.uniform([-2, -2, -1.3], [2, 2, 0.5], (12, 3))
    radius = dice.uniform(0.15, 0.5, 12)
    ball = dice.integers(12, size=on_spheres)
    normal = dice.normal(size=(on_spheres, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    spacing = 0.6 * np.sqrt(4 * np.pi * (radius**2).sum() / max(on_spheres, 1))
    round_scale = np.exp(dice.normal(np.log(spacing), 0.4, (on_spheres, 3)))
    round_scale[:, 2] = 0.003
    turn = np.cross(np.broadcast_to([0, 0, 1.0], normal.shape), normal)
    round_quat = np.concatenate([1 + normal[:, 2:], turn], axis=1)
    opaque = dice.random(count) < 0.6
    opacity = np.where(opaque, dice.uniform(0.7, 0.99, count), dice.uniform(0.02, 0.6, count))
    arrays = (
        np.concatenate([flat, center[ball] + normal * radius[ball][:, None]]),
        np.concatenate([flat_quat, round_quat]),
        np.concatenate([flat_scale, round_scale]),
        opacity,
    )
    color = jnp.asarray(dice.random((count, 3)), jnp.float32)
    return Gaussians(*(jnp.asarray(x, jnp.float32) for x in arrays), constant_harmonics(color, 0))


def room_rays(side: int, order: np.ndarray) -> Rays:
    """A 60-degree pinhole in a corner of the room, pixels in the given order."""
    right, up, forward = room_axes()
    focal = side / 2 / np.tan(np.deg2rad(30))
    x, y = order % side + 0.5 - side / 2, order // side + 0.5 - side / 2
    direction = x[:, None] / focal * right - y[:, None] / focal * up + forward
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = np.broadcast_to(EYE, direction.shape)
    return Rays(
        jnp.asarray(origin, jnp.float32),
        jnp.asarray(direction, jnp.float32),
        jnp.zeros(len(order), jnp.float32),
    )


def dynamic_room(count: int, moving: float = 0.1, degree: int = 0, seed: int = 0) -> Scene:
    """The room, a share `moving` of whose Gaussians lie on four spheres that travel, turn and bend.

    The deformation is of a real model's size (planes of 32, 64, 128 with 16 channels, layers 128
    wide) and none of its heads is zero. Harmonics beyond the constant are small and random.
    """
    dice = np.random.default_rng(seed + 1)
    own = max(round(count * moving), 4)
    static = room(count - own, seed)
    center = np.array([[0.9, -0.6, -0.5], [-0.5, 0.4, -0.2], [0.2, -1.2, 0.1], [1.2, 0.5, 0.0]])
    radius = np.array([0.45, 0.4, 0.25, 0.3])
    scene = Scene(
        _colored(static, degree, dice),
        _colored(_on_spheres(own, center, radius, dice), degree, dice),
        _deformation(center, radius, dice),
        _single([0, 1]),
    )
    return scene


def _on_spheres(count: int, center: np.ndarray, radius: np.ndarray, dice) -> Gaussians:
    ball = dice.integers(len(center), size=count)
    normal = dice.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    spacing = 0.6 * np.sqrt(4 * np.pi * (radius**2).sum() / count)
    scale = np.exp(dice.normal(np.log(spacing), 0.4, (count, 3)))
    scale[:, 2] = 0.003
    turn = np.cross(np.broadcast_to([0, 0, 1.0], normal.shape), normal)
    opaque = dice.random(count) < 0.6
    opacity = np.where(opaque, dice.uniform(0.7, 0.99, count), dice.uniform(0.02, 0.6, count))
    return Gaussians(
        _single(center[ball] + normal * radius[ball][:, None]),
        _single(np.concatenate([1 + normal[:, 2:], turn], axis=1)),
        _single(scale),
        _single(opacity),
        constant_harmonics(_single(dice.random((count, 3))), 0),
    )


def _colored(gaussians: Gaussians, degree: int, dice) -> Gaussians:
    """With random harmonics up to a degree, the higher the smaller."""
    first, parts = gaussians.harmonics, []
    for order in range(1, degree + 1):
        shape = gaussians.count, 2 * order + 1, 3
        parts.append(_single(dice.normal(0, 0.15 / order, shape)))
    return eqx.tree_at(lambda g: g.harmonics, gaussians, jnp.concatenate([first, *parts], axis=1))


def _deformation(center: np.ndarray, radius: np.ndarray, dice) -> Deformation:
    time = np.linspace(0, 1, INSTANTS)
    angle = 2 * np.pi * time[None] * dice.uniform(0.3, 0.6, (len(center), 1))
    start = dice.uniform(0, 2 * np.pi, (len(center), 1))
    path = 0.5 * np.stack(
        [np.cos(start + angle), np.sin(start + angle), 0.4 * np.sin(2 * angle)], axis=-1
    )
    half = angle / 2
    turn = np.stack([np.cos(half), 0.3 * np.sin(half), 0 * half, np.sin(half)], axis=-1)
    bodies = Bodies(
        _single(center), _single(1.2 * radius), _single(time),
        _single(path - path[:, :1]), _single(turn),
    )  # fmt: skip
    planes = initial_planes(
        jax.random.key(0), _single([-3, -3, -1.5]), _single([3, 3, 1.5]), (0.0, 1.0),
        sides=(32, 64, 128), instants=INSTANTS, channels=16,
    )  # fmt: skip
    varied = tuple(_single(1 + dice.normal(0, 0.2, plane.shape)) for plane in planes.time)
    planes = eqx.tree_at(lambda p: p.time, planes, varied)
    field = initial_deformation(jax.random.key(1), planes, bodies, width=128)
    # Residuals of about: 1 cm, 3 degrees, 5 % of the scale, 10 % of the light.
    for name, size in (("mean", 0.01), ("rotation", 0.05), ("scale", 0.05), ("tint", 0.1)):
        first, last = getattr(field, name)
        weight = dice.normal(0, size / 8, last.weight.shape)
        head = first, Layer(_single(weight), last.bias)
        field = eqx.tree_at(lambda d, name=name: getattr(d, name), field, head)
    return eqx.tree_at(lambda d: d.light, field, _single(dice.normal(0, 0.05, (9, 3))))


def cameras(side: int) -> dict[str, Camera]:
    """A camera for every effect, all at the same place, halfway through the capture.

    The fisheye sees 180 degrees from corner to corner; the aperture is 6 cm wide, focused 2.5 m
    away; the rolling shutter reads for one interval of the capture; rows are exposed for half of
    one; the moving camera goes 30 cm aside and turns by 6 degrees while the capture lasts.
    "everything" is all of it in one camera.
    """
    focal = side / 2 / np.tan(np.deg2rad(30))
    straight = pinhole(_single([focal] * 2), _single([side / 2] * 2))
    # theta grows evenly with the distance from the centre, to 90 degrees in the corners.
    slope = np.pi / 2 / (18 * np.sqrt(2))
    fisheye = FisheyePolynomial(
        _single([0, -slope, 0, 0, 0]), _single([36, 36]), _single([side] * 2), _single([0, 0]),
        _single(np.deg2rad(184)),
    )  # fmt: skip
    readout = 1 / (INSTANTS - 1)
    return {
        "pinhole": _camera(side, straight),
        "fisheye": _camera(side, fisheye),
        "depth_of_field": _camera(side, straight, radius=0.03),
        "rolling_shutter": _camera(side, straight, readout=readout),
        "motion_blur": _camera(side, straight, exposure=readout / 2),
        "moving_camera": _camera(side, straight, aside=0.3),
        "everything": _camera(side, fisheye, 0.03, readout, readout / 2, 0.3),
    }


def film_of(camera: Camera, frames: int) -> Iterator[Camera]:
    """The camera at so many moments of the capture: the frames of a video."""
    for time in np.linspace(0.1, 0.9, frames):
        yield eqx.tree_at(lambda c: c.time, camera, _single(time))


def _camera(
    side: int,
    lens: AbstractLens,
    radius: float = 0,
    readout: float = 0,
    exposure: float = 0,
    aside: float = 0,
) -> Camera:
    right, up, forward = room_axes()
    axes = np.stack([right, -up, forward], axis=1)
    times, place, turn = [0.0], [EYE], [quaternion(_single(axes))]
    if aside:
        sweep = Rotation.from_rotvec(np.deg2rad(6) * up).as_matrix()
        times, place = [0.0, 1.0], [EYE, EYE + aside * right]
        turn.append(quaternion(_single(sweep @ axes)))
    zero = _single(0)
    focus = "sphere" if lens.sees_sideways else "plane"
    return Camera(
        Film(side, side, "center"),
        lens,
        Aperture(_single(radius), _single(2.5), zero, _single(1), focus=focus),
        Shutter(_single(-readout / 2), _single(readout / max(side - 1, 1)), _single(exposure)),
        Trajectory(_single(times), jnp.stack(turn), _single(place)),
        _single(0.5),
    )


def room_axes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right, up and forward of a camera in the corner of the room."""
    forward = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    return right, np.cross(right, forward), forward


def _single(x) -> jax.Array:
    return jnp.asarray(x, jnp.float32)
