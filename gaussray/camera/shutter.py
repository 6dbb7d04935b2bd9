"""Rolling and global shutter: the time at which each row is exposed."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

from gaussray.io.plain_values import number, optional, readable, to_device, vector
from gaussray.io.validate import check_count, known, require


DIRECTIONS = ("top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left")
SIDEWAYS = DIRECTIONS[2:]
FIELDS = ("even", "odd")
# Into so many parts, at most, the precision of a frame's time must divide readout and exposure.
_READOUT_PARTS, _EXPOSURE_PARTS = 16, 4


class Shutter(eqx.Module):
    """A rolling shutter; `row_step = 0` is a global shutter.

    Row i, counted from 0 along `direction`, is exposed for `exposure` around the time
    t_i = time + trigger + row_offset + row_step i + row_times[i]. All times are in the capture's
    unit.

    Args:
        row_offset: time of row 0 relative to the frame's time.
        row_step: time from one row to the next.
        exposure: exposure time of every row, at least 0; 0 is no motion blur.
        direction: order of readout; left_to_right and right_to_left read columns.
        row_times: extra time of each row, for sensors that do not read in order; None is 0.
        trigger: delay of this camera relative to the frame's time; None is 0.
        readout_factors: `direction` as numbers that a compiled program does not hold
            (`with_readout_factors`).

    Raises:
        ValueError: If a value breaks its rule; the message names the key.
    """

    row_offset: Float[Array, ""] = eqx.field(default=0.0, converter=number("shutter.row_offset"))
    row_step: Float[Array, ""] = eqx.field(default=0.0, converter=number("shutter.row_step"))
    exposure: Float[Array, ""] = eqx.field(default=0.0, converter=number("shutter.exposure"))
    direction: str = eqx.field(static=True, default="top_to_bottom")
    row_times: Float[Array, " rows"] | None = eqx.field(
        default=None, converter=optional(vector("shutter.row_times"))
    )
    trigger: Float[Array, ""] | None = eqx.field(
        default=None, converter=optional(number("shutter.trigger"))
    )
    readout_factors: Float[Array, "3"] | None = None

    def __check_init__(self):
        require("shutter.row_offset", self.row_offset, np.isfinite, "finite")
        require("shutter.row_step", self.row_step, np.isfinite, "finite")
        exposure = self.exposure
        require("shutter.exposure", exposure, lambda e: np.isfinite(e) & (e >= 0), "at least 0")
        for key in ("row_times", "trigger"):
            if getattr(self, key) is not None:
                require(f"shutter.{key}", getattr(self, key), np.isfinite, "finite")
        if self.direction not in DIRECTIONS:
            raise ValueError(
                f"shutter.direction must be one of {DIRECTIONS}, got {self.direction!r}."
            )

    def __repr__(self) -> str:
        return readable(self)


def global_shutter(exposure: Float[Array, ""] | None = None) -> Shutter:
    """A shutter that exposes all rows at once, centred on the frame's time; None is no exposure."""
    zero = jnp.zeros(()) if exposure is None else jnp.zeros_like(exposure)
    return Shutter(zero, zero, zero if exposure is None else exposure)


def rolling_shutter(
    readout: float | int | Float[Array, ""],
    rows: int,
    exposure: float | int | Float[Array, ""] = 0.0,
    direction: str = "top_to_bottom",
) -> Shutter:
    """A shutter that reads row after row, the frame's time in the middle of the readout.

    Args:
        readout: time from the first to the last row, in the capture's unit.
        rows: number of rows (of columns, for a direction that reads columns).
        exposure: exposure time of every row.
        direction: order of readout, one of `DIRECTIONS`.

    Raises:
        ValueError: If there is no row, or another value breaks its rule.
    """
    check_count("rows", rows, 1)
    readout = number("shutter.readout")(readout)
    require("shutter.readout", readout, np.isfinite, "finite")
    return Shutter(-readout / 2, readout / max(rows - 1, 1), exposure, direction=direction)


def shutter_of_row(shutter: Shutter, resolution: tuple[int, int], row: int) -> Shutter:
    """A global shutter that exposes the whole picture when a shutter exposes one of its rows.

    Args:
        shutter: the shutter, whose exposure time is kept.
        resolution: width and height of the picture in pixels.
        row: number of the row; 0 is read first.
    """
    moment = to_device(row_moments(shutter, resolution)[row], shutter.row_offset.dtype)
    return Shutter(moment, jnp.zeros_like(moment), shutter.exposure, direction=shutter.direction)


def interlaced_row_times(
    rows: int, field_time: float, first: str = "even"
) -> Float[np.ndarray, " rows"]:
    """`row_times` of interlaced video: two fields, one after the other around the frame's time.

    Args:
        rows: number of rows.
        field_time: time from the first field to the second, in the capture's unit.
        first: the field that is read first: "even" (rows 0, 2, 4, ...) or "odd".

    Raises:
        ValueError: `first` is another word.
    """
    if first not in FIELDS:
        raise ValueError(f"shutter.first_field must be one of {FIELDS}, got {first!r}.")
    return np.where(np.arange(rows) % 2 == FIELDS.index(first), -0.5, 0.5) * field_time


def row_count(direction: str, resolution: tuple[int, int]) -> int:
    """Number of rows that a shutter reads; of columns, if it reads sideways.

    Args:
        direction: order of readout, one of `DIRECTIONS`.
        resolution: width and height of the picture in pixels.
    """
    return resolution[0] if direction in SIDEWAYS else resolution[1]


def row_step_of(readout: float, rows: int) -> float:
    """Time from one row to the next.

    Args:
        readout: time from the first row to the last.
        rows: number of rows.
    """
    return readout / max(rows - 1, 1)


def check_shutter(shutter: Shutter, resolution: tuple[int, int]) -> None:
    """Check that `row_times` has a time for each row of the picture.

    Args:
        shutter: the shutter.
        resolution: width and height of the picture in pixels.

    Raises:
        ValueError: The number of times is another.
    """
    rows = row_count(shutter.direction, resolution)
    # Within `vmap` the axis may be missing, and a stack has axes before it.
    shape = getattr(shutter.row_times, "shape", ())
    if shape and shape[-1] != rows:
        what = "column" if shutter.direction in SIDEWAYS else "row"
        raise ValueError(
            f"shutter.row_times must be one time for each of the picture's {rows} {what}s, got "
            f"{shape[-1]}."
        )


def check_time(time: Float[Array, ""], shutter: Shutter, resolution: tuple[int, int]) -> None:
    """Check that a frame's time is precise enough to tell rows and instants of exposure apart.

    Neighbouring numbers of its precision must be no further apart than a quarter of the exposure,
    and than a quarter of the time from row to row or, of many rows, a 16th of the readout.

    Args:
        time: the frame's time, in the capture's unit.
        shutter: the shutter. One of traced numbers is not checked.
        resolution: width and height of the picture in pixels.

    Raises:
        ValueError: They are further apart, so that rows or instants would share a time.
    """
    if not known(time, *jax.tree.leaves(shutter)):
        return
    check_shutter(shutter, resolution)
    moments = row_moments(shutter, resolution)
    parts = max(min(4 * (moments.shape[-1] - 1), _READOUT_PARTS), 1)
    apart = np.spacing(np.abs(np.asarray(time)))
    for name, whole, count in (
        ("readout", np.ptp(moments, axis=-1), parts),
        ("exposure", np.asarray(shutter.exposure), _EXPOSURE_PARTS),
    ):
        if np.any((whole > 0) & (apart > whole / count)):
            raise ValueError(
                f"camera.time must be so near 0 that its {apart.dtype} tells {count} parts of the "
                f"shutter's {name} ({np.max(whole):g}) apart, got {np.asarray(time):.10g}, where "
                f"numbers are {np.max(apart):.3g} apart. Subtract the first time from all, or "
                "compute in double precision (jax_enable_x64)."
            )


def row_number(
    shutter: Shutter, pixel: Num[Array, "2"], resolution: tuple[int, int]
) -> Num[Array, ""]:
    """Number of a pixel's row in the order of readout, counted from 0.

    Of its column, if the shutter reads sideways.

    Args:
        shutter: the shutter.
        pixel: index (column, row) of the pixel.
        resolution: width and height of the picture in pixels.
    """
    (column, row), (width, height) = pixel, resolution
    if shutter.readout_factors is not None:
        constant, of_column, of_row = shutter.readout_factors
        return constant + of_column * column + of_row * row
    if shutter.direction == "top_to_bottom":
        return row
    if shutter.direction == "bottom_to_top":
        return height - 1 - row
    return column if shutter.direction == "left_to_right" else width - 1 - column


def with_readout_factors(shutter: Shutter, resolution: tuple[int, int]) -> Shutter:
    """The shutter with its direction as data, so that all directions share a compiled program.

    The data are the factors of 1, column and row in `row_number`. A shutter with `row_times` is
    returned as it is.

    Args:
        shutter: the shutter.
        resolution: width and height of the picture in pixels.
    """
    if shutter.row_times is not None:
        return shutter
    width, height = resolution
    factors = {
        "top_to_bottom": (0, 0, 1),
        "bottom_to_top": (height - 1, 0, -1),
        "left_to_right": (0, 1, 0),
        "right_to_left": (width - 1, -1, 0),
    }[shutter.direction]
    factors = to_device(factors, shutter.row_step.dtype)
    return dataclasses.replace(shutter, direction="top_to_bottom", readout_factors=factors)


def first_and_last_pixels(shutter: Shutter, resolution: tuple[int, int]) -> np.ndarray:
    """Indices (column, row) of pixels that include the first and the last that the shutter reads.

    Args:
        shutter: the shutter; with `row_times`, one pixel of each row is returned.
        resolution: width and height of the picture in pixels.
    """
    width, height = resolution
    if shutter.row_times is None:
        return np.array([(0, 0), (width - 1, height - 1)])
    rows = np.arange(row_count(shutter.direction, resolution))
    first = np.zeros_like(rows)
    return np.stack([rows, first] if shutter.direction in SIDEWAYS else [first, rows], axis=-1)


def time_window(shutter: Shutter, resolution: tuple[int, int]) -> tuple[float, float]:
    """Earliest and latest time at which any row is exposed, relative to the frame's time.

    Args:
        shutter: one shutter, or a stack of them (with leading axes).
        resolution: width and height of the picture in pixels.
    """
    rows = np.arange(row_count(shutter.direction, resolution))
    middle = _moments(shutter, rows if shutter.row_times is not None else rows[[0, -1]])
    half = np.asarray(shutter.exposure, np.float64) / 2
    return float((middle.min(axis=-1) - half).min()), float((middle.max(axis=-1) + half).max())


def row_moments(shutter: Shutter, resolution: tuple[int, int]) -> Float[np.ndarray, " rows"]:
    """Middle of the exposure of every row, in the order of readout, relative to the frame's time.

    Args:
        shutter: the shutter.
        resolution: width and height of the picture in pixels.
    """
    return _moments(shutter, np.arange(row_count(shutter.direction, resolution)))


def _moments(shutter: Shutter, rows: np.ndarray) -> Float[np.ndarray, "*stack rows"]:
    fields = shutter.row_offset, shutter.row_step, shutter.trigger, shutter.row_times
    offset, step, trigger, table = (np.asarray(0 if x is None else x, np.float64) for x in fields)
    middle = (offset + trigger)[..., None] + step[..., None] * rows
    return middle if shutter.row_times is None else middle + table[..., rows]


def sample_time(
    shutter: Shutter,
    pixel: Num[Array, "2"],
    resolution: tuple[int, int],
    time: Float[Array, ""],
    u: Float[Array, ""],
) -> Float[Array, ""]:
    """Time at which a sample of a pixel sees the scene.

    All samples of a pixel share its row's time, also those that the pixel filter takes from the
    neighbouring rows.

    Args:
        shutter: the shutter.
        pixel: index (column, row) of the pixel.
        resolution: width and height of the picture in pixels.
        time: the frame's time, in the capture's unit.
        u: a number in [0, 1): the instant within the exposure. The mean over u is motion blur.
    """
    i = row_number(shutter, pixel, resolution)
    time = time + shutter.row_offset + shutter.row_step * i + shutter.exposure * (u - 0.5)
    if shutter.row_times is not None:
        time = time + shutter.row_times[i.astype(jnp.int32)]
    return time if shutter.trigger is None else time + shutter.trigger
