"""Projection of moving points through a rolling shutter: pixel and time of exposure."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaussray.camera.camera import Camera
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


def landing(
    camera: Camera,
    path: Callable[[Float[Array, ""]], Float[Array, "3"]],
    guess: Float[Array, ""],
) -> tuple[Float[Array, "2"], Float[Array, ""], Bool[Array, ""]]:
    """Place and time at which a picture sees a point of the world that goes along `path` (of time),
    and whether it does: the point is imaged, inside the picture, by a row that is read just then.

    The time solves t = reading_time(place_at(path(t), t)), by the secant method from `guess`. A
    global shutter is met at once. What runs with the readout, as fast as it or faster, may be seen
    more than once, or never: one landing is found, or none. Of two fields it is that in which is
    read, at the guess, what is seen then.
    """

    def seen(time: Array, field: Array) -> tuple[Array, Array, Array]:
        place = place_at(camera, path(time), time)
        read, step = reading_time(camera, place, field)
        return place, read - time, step

    def secant(_: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        before, missed_before, time = state
        missed = seen(time, field)[1]
        change = missed - missed_before
        # At first, and where nothing changes (a global shutter, the root itself), to what is read.
        flat = (before == time) | (change == 0) | (jnp.abs(missed) <= tiny * jnp.abs(time))
        step = jnp.where(flat, missed, -missed * (time - before) / jnp.where(flat, 1, change))
        return time, missed, time + step

    tiny = jnp.finfo(guess.dtype).eps
    field = jnp.zeros((), jnp.int32)
    if camera.shutter.row_times is not None:
        late = jnp.abs(jnp.stack([seen(guess, field + i)[1] for i in (0, 1)]))
        field = jnp.argmin(late).astype(jnp.int32)
    start = guess, jnp.zeros_like(guess), guess
    _, _, time = jax.lax.fori_loop(0, _SECANT_STEPS, secant, start)
    place, missed, step = seen(time, field)
    rounding = 8 * tiny * jnp.maximum(jnp.abs(time), jnp.abs(guess))
    met = jnp.abs(missed) <= _ROW_TOLERANCE * jnp.abs(step) + rounding
    size = jnp.asarray([camera.film.width, camera.film.height], place.dtype)
    return place, time, met & jnp.all((place >= 0) & (place <= size))
