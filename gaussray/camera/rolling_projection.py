"""Projection of moving points through a rolling shutter: pixel and time of exposure."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.shutter import row_number, sample_time
from gaussray.camera.trajectory import pose_at


# The first step goes to what is read at the guess, those that follow are secants: one is exact for
# a uniform motion on the picture, and each further one multiplies the last two errors.
_SECANT_STEPS = 4
# Accepted delay as a share of the time of a row.
_ROW_TOLERANCE = 0.05


def pixel_at(camera: Camera, point: Float[Array, "3"], time: Float[Array, ""]) -> Float[Array, "2"]:
    """Pixel of a world point, seen from the camera's pose at a time. The aperture is left out.

    Args:
        camera: the camera.
        point: position in the world, in scene units.
        time: time of the pose, in the capture's unit.

    Returns:
        Position (column, row) with pixel centres at +1/2; NaN where the lens does not image it.
    """
    return camera.lens.project(pose_at(camera.trajectory, time).inverse_apply(point))


def row_time_at(
    camera: Camera, pixel: Float[Array, "2"], field: Int[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Middle of the exposure at a position in the picture.

    In the middle of a row it is the row's own time. Between rows it is interpolated linearly, so
    that a point which lands between two rows has a time of its own. Where `row_times` are given it
    is interpolated between every second row, those of the `field`: two fields that are read one
    after the other stay apart.

    Args:
        camera: the camera.
        pixel: position (column, row), pixel centres at +1/2.
        field: 0 for rows 0, 2, 4, ...; 1 for the others.

    Returns:
        The time, and the time from one row to the next there, in the capture's unit.
    """
    size, shutter = (camera.film.width, camera.film.height), camera.shutter
    even = dataclasses.replace(shutter, row_times=None)
    time = sample_time(even, pixel - 0.5, size, camera.time, jnp.full_like(pixel[0], 0.5))
    if shutter.row_times is None:
        return time, shutter.row_step
    table, row = shutter.row_times, row_number(shutter, pixel - 0.5, size)
    last = field + (table.shape[0] - 1 - field) // 2 * 2
    below = field + 2 * jnp.floor((row - field) / 2).astype(jnp.int32)
    below = jnp.clip(below, field, jnp.maximum(last - 2, field))
    above = jnp.minimum(below + 2, last)
    step = (table[above] - table[below]) / jnp.maximum(above - below, 1)
    return time + table[below] + step * (row - below), shutter.row_step + step


class RowTiming(NamedTuple):
    """Pixel of a point at a time, and when the shutter reads that pixel.

    Args:
        pixel: position (column, row), pixel centres at +1/2; NaN where it is not imaged.
        delay: how much later than the point's time the pixel is read, in the capture's unit.
        row_step: time from one row to the next there, in the capture's unit.
    """

    pixel: Float[Array, "*points 2"]
    delay: Float[Array, "*points"]
    row_step: Float[Array, "*points"]


def row_timing(
    camera: Camera, point: Float[Array, "3"], time: Float[Array, ""], field: Int[Array, ""]
) -> RowTiming:
    """Pixel and readout delay of a world point at a time.

    Args:
        camera: the camera.
        point: position of the point at `time`, in scene units.
        time: time, in the capture's unit.
        field: see `row_time_at`.
    """
    pixel = pixel_at(camera, point, time)
    row_time, row_step = row_time_at(camera, pixel, field)
    return RowTiming(pixel, row_time - time, row_step)


class PathProjection(NamedTuple):
    """Pixels at which a picture shows moving points.

    Args:
        pixel: position (column, row), pixel centres at +1/2.
        visible: whether the point is imaged, inside the picture, by a row that is read just then.
    """

    pixel: Float[Array, "*points 2"]
    visible: Bool[Array, "*points"]


def project_paths(
    path: Callable[[Float[Array, "*points"]], Float[Array, "*points 3"]],
    timing: Callable[..., RowTiming],
    guess: Float[Array, "*points"],
    film: Film,
    *,
    fields: int = 1,
) -> PathProjection:
    """Project moving points through a rolling shutter.

    The time t of each point solves t = row_time_at(pixel_at(path(t), t)), by the secant method from
    `guess`. With a global shutter the first step is exact. A point that moves as fast as the
    readout, or faster, may be seen more than once or never: one solution is found, or none. Of two
    fields, the one that is read nearest to the guess is taken.

    Args:
        path: positions of the points, in scene units, at their times.
        timing: `row_timing` of one camera for all points: of (positions, times, fields).
        guess: times to start from, in the capture's unit.
        film: the camera's film.
        fields: 2 where the shutter has `row_times`, else 1.
    """
    field = jnp.zeros(guess.shape, jnp.int32)
    if fields > 1:
        delays = [jnp.abs(timing(path(guess), guess, field + i).delay) for i in range(fields)]
        field = _nearest_field(jnp.stack(delays))
    search = guess, jnp.zeros_like(guess), guess
    for _ in range(_SECANT_STEPS):
        time = search[2]
        search = _secant(search, timing(path(time), time, field).delay)
    time = search[2]
    return _accept(timing(path(time), time, field), time, guess, film)


@jax.jit
def _nearest_field(delay: Float[Array, "fields devices points"]) -> Int[Array, "devices points"]:
    return jnp.argmin(delay, axis=0).astype(jnp.int32)


@jax.jit
def _secant(
    search: tuple[Array, Array, Array], delay: Float[Array, "*points"]
) -> tuple[Array, Array, Array]:
    """One secant step: (previous time, its delay, time) -> (time, its delay, next time)."""
    previous, previous_delay, time = search
    tiny, change = jnp.finfo(time.dtype).eps, delay - previous_delay
    # At first, and where nothing changes (a global shutter, the root itself), to what is read.
    flat = (previous == time) | (change == 0) | (jnp.abs(delay) <= tiny * jnp.abs(time))
    step = jnp.where(flat, delay, -delay * (time - previous) / jnp.where(flat, 1, change))
    return time, delay, time + step


@partial(jax.jit, static_argnums=3)
def _accept(timing: RowTiming, time: Array, guess: Array, film: Film) -> PathProjection:
    """Points whose row is read at their time, within the tolerance, and inside the picture."""
    rounding = 8 * jnp.finfo(time.dtype).eps * jnp.maximum(jnp.abs(time), jnp.abs(guess))
    on_time = jnp.abs(timing.delay) <= _ROW_TOLERANCE * jnp.abs(timing.row_step) + rounding
    inside = [
        (timing.pixel[..., i] >= 0) & (timing.pixel[..., i] <= size)
        for i, size in enumerate((film.width, film.height))
    ]
    return PathProjection(timing.pixel, on_time & inside[0] & inside[1])
