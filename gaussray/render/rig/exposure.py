"""Aperture and shutter of a rig, from options to the parts of a camera."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.aperture import Aperture, FocusPull, Rim, no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.shutter import (
    Shutter,
    check_shutter,
    global_shutter,
    interlaced,
    row_count,
    step_of,
)


SHUTTERS = ("keep", "global", "rolling", "interlaced", "table")
# Which kinds of shutter a key says something about; the others refuse it.
SHUTTER_KEYS = {
    "readout": ("rolling", "interlaced"),
    "row_step": ("rolling", "interlaced"),
    "field_time": ("interlaced",),
    "row_times": ("table",),
}


class ApertureOptions(eqx.Module):
    """`radius` in scene units (0 = pinhole, -1 = the capture's own), `focus_distance` in scene
    units; see `camera.aperture.Aperture`. `focus_times` and `focus_distances` are a focus pull
    instead, moving as `focus_ease` says (`FocusPull`); `rim_radius` and `rim_distance` clip oblique
    beams (`Rim`), 0 is no rim."""

    radius: float = eqx.field(static=True, default=-1.0)
    focus_distance: float = eqx.field(static=True, default=2.5)
    focus: str = eqx.field(static=True, default="plane")
    blades: int = eqx.field(static=True, default=0)
    rotation: float = eqx.field(static=True, default=0.0)
    ratio: float = eqx.field(static=True, default=1.0)
    focus_times: tuple[float, ...] = eqx.field(static=True, default=())
    focus_distances: tuple[float, ...] = eqx.field(static=True, default=())
    focus_ease: str = eqx.field(static=True, default="linear")
    rim_radius: float = eqx.field(static=True, default=0.0)
    rim_distance: float = eqx.field(static=True, default=0.0)


class ShutterOptions(eqx.Module):
    """`kind`: keep (the capture's), global, rolling, interlaced or table.

    `readout` is the time from the first to the last row, or `row_step` that from row to row, and
    `exposure` that of each row, in the capture's unit of time; the frame's time is in the middle of
    the readout. Interlaced, every second row is read `field_time` after the others, `first_field`
    (even: rows 0, 2, ...) first. `row_times` are those of a table, one for each row from the
    frame's time. `trigger` is a delay of every chosen camera (in the order of camera.names, or of
    the capture), a single one for all; it composes with any kind.
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


def aperture_of(camera: Camera, options: ApertureOptions) -> Aperture:
    """The aperture that a camera gets: its own, or that of the options."""
    if options.radius == -1:
        return camera.aperture
    if options.radius == 0:
        return jax.tree.map(_single, no_aperture())
    radius, rotation, ratio = map(_single, (options.radius, options.rotation, options.ratio))
    choice = {"blades": options.blades, "focus": options.focus, "rim": _rim(options)}
    return Aperture(radius, _focus(options), rotation, ratio, **choice)


def _focus(options: ApertureOptions) -> Float[Array, ""] | FocusPull:
    times, distances = options.focus_times, options.focus_distances
    if len(times) != len(distances):
        raise ValueError(
            "aperture.focus_distances must be one for each of aperture.focus_times, got "
            f"{len(distances)} and {len(times)}."
        )
    if not times:
        return _single(options.focus_distance)
    return FocusPull(_single(times), _single(distances), options.focus_ease)


def _rim(options: ApertureOptions) -> Rim | None:
    if options.rim_radius == 0 and options.rim_distance == 0:
        return None
    for key in ("rim_radius", "rim_distance"):
        if not 0 < getattr(options, key) < np.inf:
            raise ValueError(
                f"aperture.{key} must be above 0, got {getattr(options, key)}. Both 0 is no rim."
            )
    return Rim(_single(options.rim_radius), _single(options.rim_distance))


def rolls(options: ShutterOptions) -> bool:
    """Whether rows are read one after another."""
    reads = options.readout != 0 or options.row_step != 0
    return options.kind == "table" or options.kind in ("rolling", "interlaced") and reads


def delays(options: ShutterOptions, names: Sequence[str]) -> dict[str, Float[Array, ""]]:
    """The trigger of each camera; none if none is given."""
    given = options.trigger * (len(names) if len(options.trigger) == 1 else 1)
    if given and len(given) != len(names):
        raise ValueError(
            "shutter.trigger must be one delay, or one for each of the chosen cameras "
            f"({', '.join(names)}), got {len(given)}."
        )
    return dict(zip(names, map(_single, given), strict=False))


def shutter_of(camera: Camera, options: ShutterOptions, delay: Float[Array, ""] | None) -> Shutter:
    """The shutter that a camera gets: its own, or that of the options; `delay` is its trigger."""
    shutter = camera.shutter if options.kind == "keep" else _new_shutter(camera.film, options)
    return shutter if delay is None else dataclasses.replace(shutter, trigger=delay)


def _new_shutter(film: Film, options: ShutterOptions) -> Shutter:
    if options.kind not in SHUTTERS:
        raise ValueError(f"shutter.kind must be {', '.join(SHUTTERS)}, got {options.kind!r}.")
    for key, kinds in SHUTTER_KEYS.items():
        if getattr(options, key) and options.kind not in kinds:
            raise ValueError(
                f"shutter.{key} needs shutter.kind={' or '.join(kinds)}, got {options.kind!r}."
            )
    if options.readout and options.row_step:
        raise ValueError(
            f"shutter.readout = {options.readout} and shutter.row_step = {options.row_step} both "
            "say how long the readout is: leave one of them at 0."
        )
    exposure = _single(options.exposure)
    if options.kind == "global":
        return global_shutter(exposure)
    rows = row_count(options.direction, (film.width, film.height))
    readout = options.readout or options.row_step * (rows - 1)
    table = {"rolling": None, "table": options.row_times}.get(options.kind)
    if options.kind == "interlaced":
        table = interlaced(rows, options.field_time, options.first_field)
    shutter = Shutter(
        _single(-readout / 2),
        _single(options.row_step or step_of(readout, rows)),
        exposure,
        direction=options.direction,
        row_times=None if table is None else _single(table),
    )
    check_shutter(shutter, (film.width, film.height))
    return shutter


def _single(value) -> Array:
    return jnp.asarray(value, jnp.float32)
