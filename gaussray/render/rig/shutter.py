"""The shutter of a rig's cameras, from options."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.shutter import (
    DIRECTIONS,
    Shutter,
    check_shutter,
    global_shutter,
    interlaced_row_times,
    row_count,
    row_step_of,
)
from gaussray.io.plain_values import to_device
from gaussray.io.validate import require


SHUTTERS = ("keep", "global", "rolling", "interlaced", "table")
# The kinds of shutter that use a key; all others refuse it.
_KINDS_OF_KEY = {
    "readout": ("rolling", "interlaced"),
    "row_step": ("rolling", "interlaced"),
    "field_time": ("interlaced",),
    "row_times": ("table",),
}


class ShutterOptions(eqx.Module):
    """Shutter of the cameras. All times are in the capture's unit.

    Args:
        kind: keep (the capture's own shutter), global, rolling, interlaced or table.
        readout: time from the first row to the last; the frame's time is in its middle.
        exposure: exposure time of each row.
        direction: order of readout, one of `camera.shutter.DIRECTIONS`.
        row_step: time from row to row, instead of `readout`.
        field_time: of an interlaced shutter, time from one field to the other.
        first_field: the field that is read first: even (rows 0, 2, ...) or odd.
        row_times: of a table, time of each row relative to the frame's time.
        trigger: delay of every chosen camera, in the order of camera.names or of the capture; one
            value is for all. It applies to any kind.

    Raises:
        ValueError: a time is not finite.
    """

    kind: str = eqx.field(static=True, default="keep")
    readout: float = eqx.field(static=True, default=0.0)
    exposure: float = eqx.field(static=True, default=0.0)
    direction: str = eqx.field(static=True, default="top_to_bottom")
    row_step: float = eqx.field(static=True, default=0.0)
    field_time: float = eqx.field(static=True, default=0.0)
    first_field: str = eqx.field(static=True, default="even")
    row_times: tuple[float, ...] = eqx.field(static=True, default=())
    trigger: tuple[float, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        for key in ("readout", "row_step", "field_time", "exposure", "row_times", "trigger"):
            remedy = "Give times in the capture's unit."
            require(f"shutter.{key}", getattr(self, key), np.isfinite, "finite", remedy)


def reads_rows_in_turn(options: ShutterOptions) -> bool:
    """Whether rows are read one after another."""
    has_readout = options.readout != 0 or options.row_step != 0
    return options.kind == "table" or options.kind in ("rolling", "interlaced") and has_readout


def trigger_delays(options: ShutterOptions, names: Sequence[str]) -> dict[str, Float[Array, ""]]:
    """Trigger delay of each camera by its name; empty without delays.

    Args:
        options: the options.
        names: names of the chosen cameras.

    Raises:
        ValueError: There are neither one nor as many delays as cameras.
    """
    delays = options.trigger * (len(names) if len(options.trigger) == 1 else 1)
    if delays and len(delays) != len(names):
        raise ValueError(
            "shutter.trigger must be one delay, or one for each of the chosen cameras "
            f"({', '.join(names)}), got {len(delays)}."
        )
    return dict(zip(names, map(_float32, delays), strict=False))


def build_shutter(
    camera: Camera, options: ShutterOptions, delay: Float[Array, ""] | None
) -> Shutter:
    """Build a shutter.

    Args:
        camera: the camera, whose own shutter stays with `kind="keep"`.
        options: the options.
        delay: trigger delay of the camera; None keeps the shutter's own.

    Raises:
        ValueError: A value breaks its rule.
    """
    shutter = camera.shutter if options.kind == "keep" else _new_shutter(camera.film, options)
    return shutter if delay is None else dataclasses.replace(shutter, trigger=delay)


def _new_shutter(film: Film, options: ShutterOptions) -> Shutter:
    _check_keys(options)
    exposure = _float32(options.exposure)
    if options.kind == "global":
        return global_shutter(exposure)
    rows = row_count(options.direction, (film.width, film.height))
    readout = options.readout or options.row_step * (rows - 1)
    table = {"rolling": None, "table": options.row_times}.get(options.kind)
    if options.kind == "interlaced":
        table = interlaced_row_times(rows, options.field_time, options.first_field)
        # Fields are those of the picture's rows, times are in the order of readout.
        table = table[::-1] if options.direction in DIRECTIONS[1::2] else table
    shutter = Shutter(
        _float32(-readout / 2),
        _float32(options.row_step or row_step_of(readout, rows)),
        exposure,
        direction=options.direction,
        row_times=None if table is None else _float32(table),
    )
    check_shutter(shutter, (film.width, film.height))
    return shutter


def _check_keys(options: ShutterOptions) -> None:
    """Raise a ValueError for an unknown kind, or a key that the kind does not use."""
    if options.kind not in SHUTTERS:
        raise ValueError(f"shutter.kind must be {', '.join(SHUTTERS)}, got {options.kind!r}.")
    for key, kinds in _KINDS_OF_KEY.items():
        if getattr(options, key) and options.kind not in kinds:
            raise ValueError(
                f"shutter.{key} needs shutter.kind={' or '.join(kinds)}, got {options.kind!r}."
            )
    if options.readout and options.row_step:
        raise ValueError(
            f"shutter.readout = {options.readout} and shutter.row_step = {options.row_step} both "
            "say how long the readout is: leave one of them at 0."
        )


def _float32(value) -> Array:
    return to_device(value, jnp.float32)
