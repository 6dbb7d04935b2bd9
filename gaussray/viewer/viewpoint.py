"""Where one stands in a scene, and when: the part of a camera that the mouse moves."""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.camera.aperture import no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import Pinhole, pinhole
from gaussray.camera.shutter import Shutter
from gaussray.camera.trajectory import Trajectory, pose_at
from gaussray.capture.formats.paired import View
from gaussray.geometry import rotation_matrix
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, segment_at


# Name of the camera that the page holds.
NAME = "view"


class Stance(NamedTuple):
    """world_from_camera (quaternion wxyz, place) at a `time` in the capture's unit."""

    quat: tuple[float, float, float, float]
    place: tuple[float, float, float]
    time: float


def stance_of(camera: Camera) -> Stance:
    """Where a camera stands at its frame's time."""
    pose = jax.device_get(pose_at(camera.trajectory, camera.time))
    quat, place = (tuple(float(x) for x in part) for part in (pose.quat, pose.translation))
    return Stance(quat, place, float(camera.time))  # type: ignore[arg-type]


def standing(view: View, stance: Stance, size: tuple[int, int]) -> View:
    """A view from a stance: an ideal pinhole of this size with the capture's pixel filter, in which
    a rig puts everything else."""
    old, zero = view.camera, jnp.zeros((), jnp.float32)
    film = Film(*size, old.film.filter, old.film.filter_width)
    side = jnp.asarray(size, jnp.float32)
    none = jax.tree.map(lambda x: x.astype(jnp.float32), no_aperture())
    time = jnp.asarray(stance.time, jnp.float32)
    lens = pinhole(jnp.full(2, side[0]), side / 2)
    camera = Camera(film, lens, none, Shutter(zero, zero, zero), path_of(stance), time)
    named = {"camera_name": NAME, "split": "test", "time": stance.time, "window": None}
    return dataclasses.replace(view, camera=camera, **named)


def path_of(stance: Stance) -> Trajectory:
    """That of a camera which stays where it is."""
    return Trajectory(
        jnp.zeros(1, jnp.float32),
        jnp.asarray([stance.quat], jnp.float32),
        jnp.asarray([stance.place], jnp.float32),
    )


def field_of(camera: Camera) -> float:
    """Horizontal field of view in degrees of the pinhole that is nearest to a camera: its own, if
    it is one, or 65."""
    if not isinstance(camera.lens, Pinhole):
        return 65.0
    field = math.degrees(2 * math.atan(camera.film.width / 2 / float(camera.lens.focal[0])))
    return float(f"{field:.6g}")  # as exact as single precision


def upwards(views: Sequence[View]) -> Float[np.ndarray, "3"]:
    """Up in the world: against the mean of what the cameras call down."""
    down = np.mean([_axes(view.camera)[:, 1] for view in views], axis=0)
    length = np.linalg.norm(down)
    return -down / length if length > 0.1 else -_axes(views[0].camera)[:, 1]


def forwards(stance: Stance) -> Float[np.ndarray, "3"]:
    """The direction in which one looks."""
    return np.asarray(rotation_matrix(jnp.asarray(stance.quat)))[:, 2]


def distance_of(scene: Scene | Clip, stance: Stance) -> float:
    """How far away what one looks at is: the median depth of the Gaussians within 20 degrees of
    the axis; where there are none, of all."""
    part = segment_at(scene, stance.time)
    mean = np.concatenate([np.asarray(x.mean, np.float64) for x in (part.static, part.moving)])
    way = mean - np.asarray(stance.place)
    depth, length = way @ forwards(stance), np.linalg.norm(way, axis=1)
    ahead = depth > math.cos(math.radians(20)) * np.maximum(length, 1e-9)
    return float(np.median(depth[ahead] if ahead.any() else length))


def _axes(camera: Camera) -> Float[np.ndarray, "3 3"]:
    """Right, down and forward as columns."""
    return np.asarray(rotation_matrix(pose_at(camera.trajectory, camera.time).quat), np.float64)
