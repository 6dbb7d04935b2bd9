"""Cameras without a capture: placed by a point to look at, on an orbit, or along a path."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import pinhole
from gaussray.camera.placement import look_at, orbit
from gaussray.camera.trajectory import Trajectory, pose_at
from gaussray.capture.capture import View
from gaussray.geometry import rotation_matrix
from gaussray.io.plain_values import to_device
from gaussray.io.validate import require
from gaussray.render.rig.trajectory import path_of_key
from gaussray.scene.scene import Scene, at
from gaussray.scene.segmented import Clip, segment_at


CAMERA_KINDS = ("capture", "look_at", "orbit", "path")
# A camera without a capture: size of the picture in pixels, and degrees from left to right.
_SIZE, _FOV = (960, 640), 50.0
# Share of the Gaussians that shall be in view, and the room around them.
_IN_VIEW, _ROOM = 0.8, 1.15
# Up without a capture; and the weight of the mean upward axis where horizontal axes do not tell.
_Z_UP, _LEVEL = np.array([0.0, 0.0, 1.0]), 0.03


class CameraOptions(eqx.Module):
    """Which cameras render the scene.

    Args:
        kind: "capture" renders frames of a capture: those of the cameras in `names` (empty: all
            cameras of `split`) at the `times` (empty: all). The others need no capture: "look_at"
            stands still, "orbit" circles around `target`, "path" follows the poses of `file`.
        split: train, test, or all for both.
        names: names of cameras, instead of a split; frames, and what is given for each camera,
            follow their order. `trajectory=between` may return to a camera.
        times: times of frames in the scene's unit.
        eye: position of the camera, of an orbit its first one. Empty is the position of one of the
            capture's cameras; without a capture, one outside the scene that sees all of it.
        target: the point in the middle of the picture; empty is the middle of the scene.
        up: direction that points up in the picture, the axis of an orbit. Empty is the direction
            that is up in the capture's pictures; without a capture, +z.
        frames: number of frames, evenly over the scene's times.
        turns: full turns of an orbit; negative is clockwise as seen from above.
        file: camera path (`capture.paths`).
        clip_start: nothing nearer to the camera is seen, in scene units. None is what the capture
            says of its cameras (`Camera.clip_start`), and 0 for the others.
    """

    kind: str = eqx.field(static=True, default="capture")
    split: str = eqx.field(static=True, default="test")
    names: tuple[str, ...] = eqx.field(static=True, default=())
    times: tuple[float, ...] = eqx.field(static=True, default=())
    eye: tuple[float, ...] = eqx.field(static=True, default=())
    target: tuple[float, ...] = eqx.field(static=True, default=())
    up: tuple[float, ...] = eqx.field(static=True, default=())
    frames: int = eqx.field(static=True, default=1)
    turns: float = eqx.field(static=True, default=1.0)
    file: str = eqx.field(static=True, default="")
    clip_start: float | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.clip_start is not None and not 0 <= self.clip_start < np.inf:
            raise ValueError(f"camera.clip_start must be at least 0, got {self.clip_start}.")
        if self.kind not in CAMERA_KINDS:
            raise ValueError(
                f"camera.kind must be one of {', '.join(CAMERA_KINDS)}, got {self.kind!r}."
            )
        if self.split not in ("train", "test", "all"):
            raise ValueError(f"camera.split must be train, test or all, got {self.split!r}.")
        remedy = "Give times in the scene's unit."
        require("camera.times", self.times, np.isfinite, "finite", remedy)
        if self.frames < 1:
            raise ValueError(f"camera.frames must be at least 1, got {self.frames}.")
        for key in ("eye", "target", "up"):
            value = getattr(self, key)
            if len(value) not in (0, 3):
                raise ValueError(f"camera.{key} must be three numbers, got {list(value)}.")


def placed_views(
    scene: Scene | Clip, options: CameraOptions, views: Sequence[View] = ()
) -> list[View]:
    """The frames of a camera that the options place in a scene.

    Film, lens, aperture and shutter are those of the first of a capture's `views`; without any, the
    camera is a pinhole of 50 degrees with pictures of 960 x 640.

    Args:
        scene: the scene.
        options: kind, position and path of the camera.
        views: views of a capture.

    Raises:
        ValueError: A value breaks its rule.
        OSError: `camera.file` cannot be read.
    """
    first, last = (float(t) for t in np.asarray(scene.time_range))
    if first == last and options.kind != "look_at":
        last = first + 1  # the scene stands still, and the camera moves
    times = np.array(options.times) if options.times else np.linspace(first, last, options.frames)
    base = _base_camera(views)
    path = _trajectory(scene, options, base, [view.camera for view in views], (first, last))
    cameras = (
        dataclasses.replace(base, trajectory=path, time=to_device(time, jnp.float32))
        for time in times
    )
    return [
        View(
            camera, Path(), None, None, options.kind, "test", float(camera.time), "pinhole", None,
            "srgb",
        )
        for camera in cameras
    ]  # fmt: skip


def _base_camera(views: Sequence[View]) -> Camera:
    if views:
        # It stands elsewhere, in no camera's body.
        return jax.tree.map(jnp.asarray, dataclasses.replace(views[0].camera, clip_start=None))
    width, height = _SIZE
    focal = jnp.full(2, width / 2 / np.tan(np.deg2rad(_FOV) / 2), jnp.float32)
    lens = pinhole(focal, to_device([width / 2, height / 2], jnp.float32))
    return jax.tree.map(lambda x: x.astype(jnp.float32), Camera(Film(width, height), lens))


def _trajectory(
    scene: Scene | Clip,
    options: CameraOptions,
    base: Camera,
    cameras: Sequence[Camera],
    times: tuple[float, float],
) -> Trajectory:
    first, last = times if times[0] < times[1] else (times[0], times[0] + 1)
    if options.kind == "path":
        path = _path_of_file(options.file, (first, last))
    else:
        eye, target, up = _placement(scene, options, base, cameras)
        if options.kind == "look_at":
            path = look_at(eye, target, up)
        else:
            # A last frame at the place of the first would be seen twice in a loop.
            end = first + (last - first) * options.frames / max(options.frames - 1, 1)
            path = orbit(eye, target, up, turns=options.turns, times=(first, end))
    return jax.tree.map(lambda x: x.astype(jnp.float32), path)


def _path_of_file(file: str, times: tuple[float, float]) -> Trajectory:
    """The poses of a file, stretched over the scene's times."""
    if not file:
        raise ValueError("camera=path needs camera.file, a file of camera poses.")
    first, last = times
    knots, quat, position = path_of_key("camera.file", file)
    if len(knots) > 1:
        knots = first + (knots - knots[0]) / (knots[-1] - knots[0]) * (last - first)
    knots, quat, position = (to_device(x, jnp.float32) for x in (knots, quat, position))
    return Trajectory(knots, quat, position)


def _placement(
    scene: Scene | Clip, options: CameraOptions, base: Camera, cameras: Sequence[Camera]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Eye, target and up: those of the options, otherwise from the capture or the scene."""
    eye, target, up = (np.array(x, float) for x in (options.eye, options.target, options.up))
    poses = [pose_at(camera.trajectory, camera.time) for camera in cameras]
    position = np.array([np.asarray(pose.translation, float) for pose in poses]).reshape(-1, 3)
    if not len(up):
        turn = [np.asarray(rotation_matrix(pose.quat), float) for pose in poses]
        up = _upright(np.array(turn)) if turn else _Z_UP
    if not (len(eye) and len(target)):
        middle, radius = bounding_ball(scene)
        target = target if len(target) else middle
        if not len(eye):
            near = _near_position(position, target, up)
            eye = _viewpoint(target, radius, up, base) if near is None else near
    return eye, target, up


def _upright(rotation: Float[np.ndarray, "cameras 3 3"]) -> Float[np.ndarray, "3"]:
    """The direction that is up for people who hold their cameras level.

    It is at right angles to the horizontal axes of all cameras. Where these do not tell (cameras
    side by side), it is the mean of the cameras' own upward axes.
    """
    right, mean = rotation[:, :, 0], -rotation[:, :, 1].mean(axis=0)
    length = np.linalg.norm(mean)
    if length < 1e-6:
        return _Z_UP
    mean = mean / length
    spread = right.T @ right / len(right) + _LEVEL * (np.eye(3) - np.outer(mean, mean))
    up = np.linalg.eigh(spread)[1][:, 0]
    return up if up @ mean > 0 else -up


def _near_position(
    position: Float[np.ndarray, "cameras 3"],
    target: Float[np.ndarray, "3"],
    up: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "3"] | None:
    """The position of a camera than which a quarter of all are nearer to the axis of the orbit:
    inside a room, the orbit then does not leave it. None if all cameras are on the axis."""
    if not len(position):
        return None
    offset = position - target
    # `look_at` refuses an up of zero.
    level = offset - np.outer(offset @ up, up) / ((up @ up) or 1.0)
    distance = np.linalg.norm(level, axis=1)
    chosen = int(np.argsort(distance)[len(distance) // 4])
    return position[chosen] if distance[chosen] > 1e-3 * np.linalg.norm(offset[chosen]) else None


def bounding_ball(scene: Scene | Clip) -> tuple[Float[np.ndarray, "3"], float]:
    """Middle of a scene at its first time, and the radius around it that holds four fifths of the
    centres of its Gaussians.

    Raises:
        ValueError: the scene has no Gaussians.
    """
    time = float(scene.time_range[0])
    part = segment_at(scene, time)
    mean = np.asarray(at(part, jnp.asarray(time, part.time_range.dtype)).mean, np.float64)
    mean = mean[np.all(np.isfinite(mean), axis=-1)]
    if not len(mean):
        raise ValueError("camera.eye must be given for a scene without Gaussians.")
    middle = np.median(mean, axis=0)
    return middle, float(np.quantile(np.linalg.norm(mean - middle, axis=-1), _IN_VIEW))


def _viewpoint(
    target: Float[np.ndarray, "3"], radius: float, up: Float[np.ndarray, "3"], base: Camera
) -> Float[np.ndarray, "3"]:
    """A position from which a ball around the target is in view, a little above it."""
    vertical = up / max(np.linalg.norm(up), 1e-12)
    # The horizontal direction nearest to -y, or to -z where up is along y.
    side = np.array([0.0, -1, 0]) if abs(vertical[1]) < 0.9 else np.array([0.0, 0, -1])
    side = side - np.dot(side, vertical) * vertical
    direction = side / np.linalg.norm(side) + 0.35 * vertical
    film, lens = base.film, jax.tree.map(jnp.asarray, base.lens)
    edge = lens.direction(jnp.asarray([film.width / 2, 1.0], jnp.float32))
    half = float(np.clip(np.arctan2(np.hypot(edge[0], edge[1]), edge[2]), 0.1, 1.2))
    distance = _ROOM * max(radius, 1e-6) / np.sin(half)
    return target + distance * direction / np.linalg.norm(direction)
