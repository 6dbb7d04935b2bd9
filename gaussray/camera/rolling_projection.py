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
# Share of a row's time by which the row found may miss, a twentieth of a pixel's motion by a pixel.
_ROW_TOLERANCE = 0.05


def place_at(camera: Camera, point: Float[Array, "3"], time: Float[Array, ""]) -> Float[Array, "2"]:
    """Pixel (column, row; centres at + 1/2) of a point of the world, seen from the camera's pose at
    a time; NaN where it is not imaged. The aperture is left out."""
    return camera.lens.project(pose_at(camera.trajectory, time).inverse_apply(point))


def reading_time(
    camera: Camera, place: Float[Array, "2"], field: Int[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Middle of the exposure of a place in the picture, and the time from row to row there, in the
    capture's unit. It is that of its row in the row's middle and even in between, so that what
    lands between rows has a time of its own.

    Where rows have times of their own, in between is between every second row, those of the `field`
    (0: rows 0, 2, 4, ..., 1: the others): fields that are read one after the other stay apart.
    """
    size, shutter = (camera.film.width, camera.film.height), camera.shutter
    even = dataclasses.replace(shutter, row_times=None)
    time = sample_time(even, place - 0.5, size, camera.time, jnp.full_like(place[0], 0.5))
    if shutter.row_times is None:
        return time, shutter.row_step
    table, row = shutter.row_times, row_number(shutter, place - 0.5, size)
    last = field + (table.shape[0] - 1 - field) // 2 * 2
    below = field + 2 * jnp.floor((row - field) / 2).astype(jnp.int32)
    below = jnp.clip(below, field, jnp.maximum(last - 2, field))
    above = jnp.minimum(below + 2, last)
    step = (table[above] - table[below]) / jnp.maximum(above - below, 1)
    return time + table[below] + step * (row - below), shutter.row_step + step


class Reading(NamedTuple):
    """What a picture reads of a point at a time: its place in pixels, how much later that place is
    read (`missed`, in the capture's unit), and the time from row to row there."""

    place: Float[Array, "*points 2"]
    missed: Float[Array, "*points"]
    step: Float[Array, "*points"]


def reading(
    camera: Camera, point: Float[Array, "3"], time: Float[Array, ""], field: Int[Array, ""]
) -> Reading:
    """What a picture reads of a point of the world that is at `point` at a time."""
    place = place_at(camera, point, time)
    read, step = reading_time(camera, place, field)
    return Reading(place, read - time, step)


class Landing(NamedTuple):
    """Place at which a picture sees points of the world, and whether it does: a point is imaged,
    inside the picture, by a row that is read just then."""

    place: Float[Array, "*points 2"]
    met: Bool[Array, "*points"]


def landing(
    path: Callable[[Float[Array, "*points"]], Float[Array, "*points 3"]],
    read: Callable[..., Reading],
    guess: Float[Array, "*points"],
    film: Film,
    *,
    fields: int = 1,
) -> Landing:
    """Where a picture sees points of the world that go along paths.

    The time solves t = reading_time(place_at(path(t), t)), by the secant method from `guess`. A
    global shutter is met at once. What runs with the readout, as fast as it or faster, may be seen
    more than once, or never: one landing is found, or none. Of two fields it is that in which is
    read, at the guess, what is seen then.

    Args:
        path: Places at times.
        read: `reading` of one camera for all points: of (place, time, field).
        guess: Times to start from.
        film: The camera's film.
        fields: 2 where rows have times of their own, else 1.
    """
    field = jnp.zeros(guess.shape, jnp.int32)
    if fields > 1:
        late = [jnp.abs(read(path(guess), guess, field + i).missed) for i in range(fields)]
        field = _least(jnp.stack(late))
    search = guess, jnp.zeros_like(guess), guess
    for _ in range(_SECANT_STEPS):
        time = search[2]
        search = _secant(search, read(path(time), time, field).missed)
    time = search[2]
    return _landed(read(path(time), time, field), time, guess, film)


@jax.jit
def _least(late: Float[Array, "fields devices points"]) -> Int[Array, "devices points"]:
    return jnp.argmin(late, axis=0).astype(jnp.int32)


@jax.jit
def _secant(
    search: tuple[Array, Array, Array], missed: Float[Array, "*points"]
) -> tuple[Array, Array, Array]:
    """The time tried last, by how much it was missed, and the time to try next, from the same one
    step before and how much that time was missed."""
    before, missed_before, time = search
    tiny, change = jnp.finfo(time.dtype).eps, missed - missed_before
    # At first, and where nothing changes (a global shutter, the root itself), to what is read.
    flat = (before == time) | (change == 0) | (jnp.abs(missed) <= tiny * jnp.abs(time))
    step = jnp.where(flat, missed, -missed * (time - before) / jnp.where(flat, 1, change))
    return time, missed, time + step


@partial(jax.jit, static_argnums=3)
def _landed(found: Reading, time: Array, guess: Array, film: Film) -> Landing:
    rounding = 8 * jnp.finfo(time.dtype).eps * jnp.maximum(jnp.abs(time), jnp.abs(guess))
    met = jnp.abs(found.missed) <= _ROW_TOLERANCE * jnp.abs(found.step) + rounding
    inside = [
        (found.place[..., i] >= 0) & (found.place[..., i] <= size)
        for i, size in enumerate((film.width, film.height))
    ]
    return Landing(found.place, met & inside[0] & inside[1])
