"""When each row of the sensor sees the scene."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

from gaussray.camera.checks import require


DIRECTIONS = ("top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left")


class Shutter(eqx.Module):
    """Rolling shutter, in the capture's unit of time; `row_step = 0` is a global shutter.

    Row i, counted along `direction` from 0, is exposed during `exposure` around
    time + row_offset + row_step i. `exposure = 0` is an instant: no motion blur.
    """

    row_offset: Float[Array, ""]
    row_step: Float[Array, ""]
    exposure: Float[Array, ""]
    direction: str = eqx.field(static=True, default="top_to_bottom")

    def __check_init__(self):
        require("shutter.row_offset", self.row_offset, np.isfinite, "finite")
        require("shutter.row_step", self.row_step, np.isfinite, "finite")
        exposure = self.exposure
        require("shutter.exposure", exposure, lambda e: np.isfinite(e) & (e >= 0), "at least 0")
        if self.direction not in DIRECTIONS:
            raise ValueError(
                f"shutter.direction must be one of {DIRECTIONS}, got {self.direction!r}."
            )


def global_shutter(exposure: Float[Array, ""] | None = None) -> Shutter:
    """All rows at once: an instant, or an exposure centred on the frame's time."""
    zero = jnp.zeros(())
    return Shutter(zero, zero, zero if exposure is None else exposure)


def row_number(
    shutter: Shutter, pixel: Num[Array, "2"], resolution: tuple[int, int]
) -> Num[Array, ""]:
    """How many rows (columns, if it reads sideways) the shutter has read before this pixel's."""
    (column, row), (width, height) = pixel, resolution
    if shutter.direction == "top_to_bottom":
        return row
    if shutter.direction == "bottom_to_top":
        return height - 1 - row
    return column if shutter.direction == "left_to_right" else width - 1 - column


def time_window(shutter: Shutter, resolution: tuple[int, int]) -> tuple[float, float]:
    """Earliest and latest moment, counted from the frame's time, at which any row looks: of one
    shutter, or of all of a stack. On the host."""
    sideways = shutter.direction in ("left_to_right", "right_to_left")
    rows = resolution[0] if sideways else resolution[1]
    values = shutter.row_offset, shutter.row_step, shutter.exposure
    first, step, exposure = (np.asarray(x, np.float64) for x in values)
    last = first + step * (rows - 1)
    earliest = np.minimum(first, last) - exposure / 2
    return float(earliest.min()), float((np.maximum(first, last) + exposure / 2).max())


def sample_time(
    shutter: Shutter,
    pixel: Num[Array, "2"],
    resolution: tuple[int, int],
    time: Float[Array, ""],
    u: Float[Array, ""],
) -> Float[Array, ""]:
    """Time at which a sample of the pixel with index (column, row) sees the scene.

    `u` in [0, 1) picks an instant of the exposure: averaging over it is motion blur. All samples of
    a pixel share its row's time, also those that its filter takes from the neighbouring rows.
    """
    i = row_number(shutter, pixel, resolution)
    return time + shutter.row_offset + shutter.row_step * i + shutter.exposure * (u - 0.5)
