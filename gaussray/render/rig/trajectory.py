"""The paths that the cameras of a rig take, from options to trajectories."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.shake import Shake
from gaussray.camera.trajectory import Trajectory, pose_at
from gaussray.capture.paths import read_path


PATHS = ("keep", "between", "path")
CLOCKS = ("span", "file")


class TrajectoryOptions(eqx.Module):
    """`kind`: keep (the capture's), between (an even ride through the chosen cameras, in their
    order, over the chosen times) or path (the poses in `file`, see `capture.paths`), of `steps`
    frames.

    `interpolation` between poses is linear or spline. The `clock` of a path is span (its first and
    last moment are the chosen times' first and last) or file (its times are the capture's).
    `shake_degrees` and `shake_distance` (scene units) are standard deviations per axis of a hand
    that holds the camera, correlated over `shake_time` (the capture's unit), by `shake_seed` and
    the numbers after it, one for each camera; they compose with any kind (`camera.shake`).
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


def moved(
    chosen: list[tuple[str, str, Camera]], options: TrajectoryOptions
) -> list[tuple[str, str, Camera]]:
    """The chosen frames, or those of a ride instead, held by a hand."""
    if options.steps < 1:
        raise ValueError(f"trajectory.steps must be at least 1, got {options.steps}.")
    if options.kind not in PATHS:
        raise ValueError(f"trajectory.kind must be {', '.join(PATHS)}, got {options.kind!r}.")
    for key, kind, default in (("file", "path", ""), ("clock", "path", "span")):
        if options.kind != kind and getattr(options, key) != default:
            raise ValueError(
                f"trajectory.{key} needs trajectory.kind={kind}, got {options.kind!r}."
            )
    if options.kind == "keep":
        filmed = chosen
        if options.interpolation != "linear":
            kind = options.interpolation
            filmed = [(n, s, _held(camera, interpolation=kind)) for n, s, camera in chosen]
    else:
        path, times = _ride(chosen, options)
        base = _stops(chosen)[0]
        parts = base.film, base.lens, base.aperture, base.shutter, path
        filmed = [("ride", "test", Camera(*parts, jnp.asarray(time))) for time in times]
    if not options.shake_degrees and not options.shake_distance:
        return filmed
    names = list(dict.fromkeys(name for name, _, _ in filmed))
    hands = {name: _shake(options, i) for i, name in enumerate(names)}
    return [(name, split, _held(camera, shake=hands[name])) for name, split, camera in filmed]


def _held(camera: Camera, **changes: Any) -> Camera:
    path = dataclasses.replace(camera.trajectory, **changes)
    return dataclasses.replace(camera, trajectory=path)


def _shake(options: TrajectoryOptions, number: int) -> Shake:
    for key in ("shake_degrees", "shake_distance", "shake_seed"):
        if not 0 <= getattr(options, key) < np.inf:
            raise ValueError(f"trajectory.{key} must be at least 0, got {getattr(options, key)}.")
    if not 0 < options.shake_time < np.inf:
        raise ValueError(f"trajectory.shake_time must be above 0, got {options.shake_time}.")
    turn = np.deg2rad(options.shake_degrees)
    parts = turn, options.shake_distance, options.shake_time, options.shake_seed + number
    return Shake(*map(_single, parts))


def _ride(
    chosen: list[tuple[str, str, Camera]], options: TrajectoryOptions
) -> tuple[Trajectory, Float[np.ndarray, " steps"]]:
    """A path through the poses of all cameras, or of a file, and when its frames are taken."""
    moments = sorted({float(camera.time) for _, _, camera in chosen})
    first, last = moments[0], moments[-1]
    last = last if first < last else first + 1
    if options.kind == "path":
        if not options.file:
            raise ValueError("trajectory.kind=path needs trajectory.file, a file of camera poses.")
        times, quat, place = read_path(options.file)
        if options.clock not in CLOCKS:
            raise ValueError(f"trajectory.clock must be one of {CLOCKS}, got {options.clock!r}.")
        if options.clock == "file":
            first, last = times[0], times[-1]
        elif len(times) > 1:
            times = first + (times - times[0]) / (times[-1] - times[0]) * (last - first)
    else:
        stops = _stops(chosen)
        if len(stops) < 2:
            raise ValueError(
                "trajectory.kind=between needs at least two cameras; name them in camera.names."
            )
        poses = [pose_at(camera.trajectory, camera.time) for camera in stops]
        quat, place = (jnp.stack([getattr(p, k) for p in poses]) for k in ("quat", "translation"))
        times = jnp.linspace(first, last, len(stops))
    times, quat, place = (_single(x) for x in (times, quat, place))
    path = Trajectory(times, quat, place, options.interpolation)
    return path, np.linspace(first, last, options.steps).astype(np.float32)


def _stops(chosen: Sequence[tuple[str, str, Camera]]) -> list[Camera]:
    """One of the frames of every camera."""
    return list({name: camera for name, _, camera in chosen}.values())


def _single(value) -> Array:
    return jnp.asarray(value, jnp.float32)
