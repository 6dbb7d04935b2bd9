"""A viewpoint: pose and time of the viewer's camera, the part that the mouse moves."""

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
from gaussray.capture.capture import View
from gaussray.geometry import rotation_matrix
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, segment_at


# Name of the viewer's camera.
CAMERA_NAME = "view"


class Viewpoint(NamedTuple):
    """world_from_camera (quaternion wxyz, position) at a `time` in the capture's unit."""

    quat: tuple[float, float, float, float]
    position: tuple[float, float, float]
    time: float


def viewpoint_of(camera: Camera) -> Viewpoint:
    """A camera's viewpoint at its frame's time."""
    pose = jax.device_get(pose_at(camera.trajectory, camera.time))
    quat, position = (tuple(float(x) for x in part) for part in (pose.quat, pose.translation))
    return Viewpoint(quat, position, float(camera.time))  # type: ignore[arg-type]


def view_at(view: View, viewpoint: Viewpoint, size: tuple[int, int]) -> View:
    """A view from a viewpoint, by an ideal pinhole camera with a field of view of 53 degrees.

    The viewer's configuration replaces its lens, aperture and shutter.

    Args:
        view: a view of the capture, whose pixel filter is kept.
        viewpoint: pose and time of the camera.
        size: width and height of the picture in pixels.
    """
    old, zero = view.camera, jnp.zeros((), jnp.float32)
    film = Film(*size, old.film.filter, old.film.filter_width)
    side = jnp.asarray(size, jnp.float32)
    none = jax.tree.map(lambda x: x.astype(jnp.float32), no_aperture())
    time = jnp.asarray(viewpoint.time, jnp.float32)
    lens = pinhole(jnp.full(2, side[0]), side / 2)
    path, shutter = trajectory_at(viewpoint), Shutter(zero, zero, zero)
    camera = Camera(film, lens, none, shutter, path, time, clip_start=old.clip_start)
    named = {"camera_name": CAMERA_NAME, "split": "test", "time": viewpoint.time, "window": None}
    return dataclasses.replace(view, camera=camera, **named)


def trajectory_at(viewpoint: Viewpoint) -> Trajectory:
    """The trajectory of a camera that does not move."""
    return Trajectory(
        jnp.zeros(1, jnp.float32),
        jnp.asarray([viewpoint.quat], jnp.float32),
        jnp.asarray([viewpoint.position], jnp.float32),
    )


def horizontal_fov(camera: Camera) -> float:
    """Horizontal field of view of a pinhole camera in degrees; 65 for any other lens."""
    if not isinstance(camera.lens, Pinhole):
        return 65.0
    fov = math.degrees(2 * math.atan(camera.film.width / 2 / float(camera.lens.focal[0])))
    return float(f"{fov:.6g}")  # as exact as single precision


def up_direction(views: Sequence[View]) -> Float[np.ndarray, "3"]:
    """The world's up direction: opposite to the mean down axis of the cameras."""
    down = np.mean([_axes(view.camera)[:, 1] for view in views], axis=0)
    length = np.linalg.norm(down)
    return -down / length if length > 0.1 else -_axes(views[0].camera)[:, 1]


def viewing_direction(viewpoint: Viewpoint) -> Float[np.ndarray, "3"]:
    """The unit vector along the optical axis."""
    return np.asarray(rotation_matrix(jnp.asarray(viewpoint.quat)))[:, 2]


def subject_distance(scene: Scene | Clip, viewpoint: Viewpoint) -> float:
    """Distance of the subject: the median depth of the Gaussians within 20 degrees of the optical
    axis, or the median distance of all if there are none.

    Args:
        scene: the scene, whose Gaussians count where they are at rest.
        viewpoint: pose of the camera; its time chooses the segment of a segmented scene.
    """
    part = segment_at(scene, viewpoint.time)
    mean = np.concatenate([np.asarray(x.mean, np.float64) for x in (part.static, part.moving)])
    offset = mean - np.asarray(viewpoint.position)
    depth, length = offset @ viewing_direction(viewpoint), np.linalg.norm(offset, axis=1)
    ahead = depth > math.cos(math.radians(20)) * np.maximum(length, 1e-9)
    return float(np.median(depth[ahead] if ahead.any() else length))


def _axes(camera: Camera) -> Float[np.ndarray, "3 3"]:
    """The camera's axes right, down and forward, as columns."""
    return np.asarray(rotation_matrix(pose_at(camera.trajectory, camera.time).quat), np.float64)
