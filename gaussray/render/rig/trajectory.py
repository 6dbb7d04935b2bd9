"""The trajectories of a rig's cameras, from options."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.shake import Shake
from gaussray.camera.trajectory import Trajectory, pose_at
from gaussray.capture.paths import read_path
from gaussray.io.plain_values import to_device


TRAJECTORIES = ("keep", "between", "path")
CLOCKS = ("span", "file")


class TrajectoryOptions(eqx.Module):
    """Trajectories of the cameras.

    Args:
        kind: keep (the capture's poses), between (through the poses of the chosen cameras, in the
            order of camera.names or of the capture, at even intervals over the chosen times) or
            path (the poses in `file`).
        steps: number of frames of between and path.
        interpolation: between poses: linear or spline.
        file: file of a path (`capture.paths`).
        clock: times of a path: span (its first and last pose are at the first and last of the
            chosen times) or file (its own times, in the capture's unit).
        shake_degrees: rotation of a camera shake, standard deviation per axis (`camera.shake`).
        shake_distance: translation of a camera shake, standard deviation per axis, in scene units.
        shake_time: correlation time of a camera shake, in the capture's unit.
        shake_seed: seed of a camera shake; camera i uses `shake_seed` + i.
    """

    kind: str = eqx.field(static=True, default="keep")
    steps: int = eqx.field(static=True, default=24)
    interpolation: str = eqx.field(static=True, default="linear")
    file: str = eqx.field(static=True, default="")
    clock: str = eqx.field(static=True, default="span")
    shake_degrees: float = eqx.field(static=True, default=0.0)
    shake_distance: float = eqx.field(static=True, default=0.0)
    shake_time: float = eqx.field(static=True, default=0.1)
    shake_seed: int = eqx.field(static=True, default=0)


def move_cameras(
    frames: list[tuple[str, str, Camera]],
    options: TrajectoryOptions,
    names: Sequence[str] = (),
) -> list[tuple[str, str, Camera]]:
    """Give frames the trajectory and the camera shake of the options.

    Args:
        frames: camera name, split and camera of each frame.
        options: the options.
        names: the cameras that `between` passes, in their order, which may return to one; empty:
            all in the order of the frames.

    Returns:
        The same frames, or those of one moving camera. It has film, lens, aperture and shutter of
        the first of those cameras.

    Raises:
        ValueError: A value breaks its rule.
        OSError: The path cannot be read.
    """
    _check(options)
    if options.kind == "keep":
        moved = frames
        if options.interpolation != "linear":
            moved = [(n, s, _with_interpolation(camera, options)) for n, s, camera in frames]
    else:
        path, times = _path(frames, options, names)
        base = _one_per_camera(frames, names)[0]
        parts = base.film, base.lens, base.aperture, base.shutter, path
        moved = [
            ("ride", "test", Camera(*parts, to_device(time), clip_start=base.clip_start))
            for time in times
        ]
    if not options.shake_degrees and not options.shake_distance:
        return moved
    names = list(dict.fromkeys(name for name, _, _ in moved))
    shakes = {name: _shake(options, i) for i, name in enumerate(names)}
    return [(name, split, _with_shake(camera, shakes[name])) for name, split, camera in moved]


def _check(options: TrajectoryOptions) -> None:
    if options.steps < 1:
        raise ValueError(f"trajectory.steps must be at least 1, got {options.steps}.")
    if options.kind not in TRAJECTORIES:
        raise ValueError(
            f"trajectory.kind must be {', '.join(TRAJECTORIES)}, got {options.kind!r}."
        )
    for key, kind, default in (("file", "path", ""), ("clock", "path", "span")):
        if options.kind != kind and getattr(options, key) != default:
            raise ValueError(
                f"trajectory.{key} needs trajectory.kind={kind}, got {options.kind!r}."
            )


def _with_interpolation(camera: Camera, options: TrajectoryOptions) -> Camera:
    path = dataclasses.replace(camera.trajectory, interpolation=options.interpolation)
    return dataclasses.replace(camera, trajectory=path)


def _with_shake(camera: Camera, shake: Shake) -> Camera:
    path = dataclasses.replace(camera.trajectory, shake=shake)
    return dataclasses.replace(camera, trajectory=path)


def _shake(options: TrajectoryOptions, number: int) -> Shake:
    for key in ("shake_degrees", "shake_distance", "shake_seed"):
        if not 0 <= getattr(options, key) < np.inf:
            raise ValueError(f"trajectory.{key} must be at least 0, got {getattr(options, key)}.")
    if not 0 < options.shake_time < np.inf:
        raise ValueError(f"trajectory.shake_time must be above 0, got {options.shake_time}.")
    angle = np.deg2rad(options.shake_degrees)
    parts = angle, options.shake_distance, options.shake_time, options.shake_seed + number
    return Shake(*map(_float32, parts))


def _path(
    frames: list[tuple[str, str, Camera]], options: TrajectoryOptions, names: Sequence[str]
) -> tuple[Trajectory, Float[np.ndarray, " steps"]]:
    """A trajectory through the poses of all cameras or of a file, and the times of its frames."""
    chosen = sorted({float(camera.time) for _, _, camera in frames})
    first, last = chosen[0], chosen[-1] if len(chosen) > 1 else chosen[0] + 1
    if options.kind == "path":
        if not options.file:
            raise ValueError("trajectory.kind=path needs trajectory.file, a file of camera poses.")
        times, quat, position = path_of_key("trajectory.file", options.file)
        if options.clock not in CLOCKS:
            raise ValueError(
                f"trajectory.clock must be one of {', '.join(CLOCKS)}, got {options.clock!r}."
            )
        if options.clock == "file":
            _check_clock(options, times, (chosen[0], chosen[-1]))
            first, last = times[0], times[-1]
        elif len(times) > 1:
            times = first + (times - times[0]) / (times[-1] - times[0]) * (last - first)
    else:
        cameras = _one_per_camera(frames, names)
        if len({id(camera) for camera in cameras}) < 2:
            raise ValueError(
                "trajectory.kind=between needs at least two cameras; name them in camera.names."
            )
        poses = [pose_at(camera.trajectory, camera.time) for camera in cameras]
        quat, position = (
            jnp.stack([getattr(p, k) for p in poses]) for k in ("quat", "translation")
        )
        times = jnp.linspace(first, last, len(cameras))
    times, quat, position = (_float32(x) for x in (times, quat, position))
    path = Trajectory(times, quat, position, options.interpolation)
    return path, np.linspace(first, last, options.steps).astype(np.float32)


def _check_clock(
    options: TrajectoryOptions, times: Float[np.ndarray, " poses"], chosen: tuple[float, float]
) -> None:
    """Check that single precision, in which cameras have their times, tells those of a file apart.

    Args:
        options: the options.
        times: the times of the file, in double precision.
        chosen: first and last time of the chosen frames.
    """
    first, last = times[0], times[-1]
    # A path of one pose has one time, that of every frame.
    steps = np.linspace(first, last, options.steps) if first < last else times
    apart = [bool(np.all(np.diff(x.astype(np.float32)) > 0)) for x in (times, steps)]
    if all(apart):
        return
    begin, end = chosen
    outside = ""
    remedy = "fewer trajectory.steps" if apart[0] else "leave out poses that are close in time"
    if last < begin or first > end:
        outside = f"lie outside of the chosen times, {begin:.7g} to {end:.7g}, and "
        remedy = "subtract the first time from all"
    raise ValueError(
        f"trajectory.clock=file: the times of {options.file}, {first:.12g} to {last:.12g}, "
        f"{outside}are too close to each other for single precision. Choose "
        f"trajectory.clock=span, or {remedy}."
    )


def path_of_key(
    key: str, file: str
) -> tuple[Float[np.ndarray, " poses"], Float[np.ndarray, "poses 4"], Float[np.ndarray, "poses 3"]]:
    """Times, quaternions and places of the camera path that a key names (`read_path`).

    Args:
        key: the key, for messages.
        file: its value.

    Raises:
        FileNotFoundError: There is no such file.
        CaptureError: The file is malformed.
    """
    if not Path(file).exists():
        raise FileNotFoundError(f"{key}={file}: no such file. Name a file of camera poses.")
    return read_path(file)


def _one_per_camera(
    frames: Sequence[tuple[str, str, Camera]], names: Sequence[str] = ()
) -> list[Camera]:
    """The last frame of every camera, or of every one that is named."""
    last = {name: camera for name, _, camera in frames}
    return [last[name] for name in names or last if name in last]


def _float32(value) -> Array:
    return to_device(value, jnp.float32)
