"""Converts millimetres, f-numbers and milliseconds of a real camera to the units of the scene."""

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import equinox as eqx

from gaussray.camera.film import Film
from gaussray.render.rig.rig import RigOptions


_PINHOLE_FOV = 65.0
# The keys that a key needs beside it.
_REQUIRED_KEYS = {
    "f_number": ("focal_length", "focus_distance", "units_per_metre"),
    "focus_distance": ("units_per_metre",),
    "breathing": ("focal_length", "focus_distance"),
    "readout": ("seconds_per_unit",),
    "exposure": ("seconds_per_unit",),
    "shutter_angle": ("frame_rate", "seconds_per_unit"),
}


class PhysicalOptions(eqx.Module):
    """Settings of a real camera; None is not given.

    Args:
        focal_length: in mm.
        sensor: width and height in mm.
        f_number: focal length / diameter of the aperture.
        focus_distance: in metres.
        breathing: whether the image distance is that of a thin lens instead of the focal length, so
            that the field of view changes with the focus.
        readout: in ms.
        exposure: in ms.
        shutter_angle: in degrees of a frame's 360.
        frame_rate: frames per second.
        units_per_metre: scene units per metre.
        seconds_per_unit: seconds per unit of the capture's time.

    Raises:
        ValueError: A value breaks its rule, or lacks another one.
    """

    focal_length: float | None = eqx.field(static=True, default=None)
    sensor: tuple[float, ...] = eqx.field(static=True, default=())
    f_number: float | None = eqx.field(static=True, default=None)
    focus_distance: float | None = eqx.field(static=True, default=None)
    breathing: bool = eqx.field(static=True, default=False)
    readout: float | None = eqx.field(static=True, default=None)
    exposure: float | None = eqx.field(static=True, default=None)
    shutter_angle: float | None = eqx.field(static=True, default=None)
    frame_rate: float | None = eqx.field(static=True, default=None)
    units_per_metre: float | None = eqx.field(static=True, default=None)
    seconds_per_unit: float | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        positive = ("focal_length", "f_number", "frame_rate", "units_per_metre", "seconds_per_unit")
        for key in positive:
            self._require(key, lambda x: 0 < x < math.inf, "above 0")
        self._require("focus_distance", lambda x: x > 0, "above 0 (inf is infinity)")
        for key in ("readout", "exposure"):
            self._require(key, lambda x: 0 <= x < math.inf, "at least 0")
        self._require("shutter_angle", lambda x: 0 <= x <= 360, "in 0 ... 360 degrees")
        valid = all(isinstance(x, int | float) and 0 < x < math.inf for x in self.sensor)
        if self.sensor and not (valid and len(self.sensor) == 2):
            raise ValueError(
                f"physical.sensor must be width and height in mm, above 0, got {self.sensor}."
            )
        for key, required in _REQUIRED_KEYS.items():
            missing = [name for name in required if getattr(self, name) is None]
            if getattr(self, key) not in (None, False) and missing:
                raise ValueError(f"physical.{key} needs physical.{missing[0]}, which is null.")
        self._check_focus()
        self._check_frame()

    def _require(self, key, holds, rule):
        value = getattr(self, key)
        if value is not None and not holds(value):
            raise ValueError(f"physical.{key} must be {rule}, got {value}.")

    def _check_focus(self):
        if self.focal_length is None or self.focus_distance is None:
            return
        if self.focus_distance * 1000 <= self.focal_length:
            raise ValueError(
                f"physical.focus_distance = {self.focus_distance} m must be beyond "
                f"physical.focal_length = {self.focal_length} mm: nearer, a lens forms no image."
            )

    def _check_frame(self):
        if self.exposure is not None and self.shutter_angle is not None:
            raise ValueError(
                f"physical.exposure = {self.exposure} and physical.shutter_angle = "
                f"{self.shutter_angle} say the same twice: leave one of them null."
            )
        if self.frame_rate is None:
            return
        for key in ("readout", "exposure"):
            value, frame = getattr(self, key), 1000 / self.frame_rate
            if value is not None and value > frame:
                raise ValueError(
                    f"physical.{key} = {value} ms must be at most the {frame:.6g} ms of a frame "
                    f"(physical.frame_rate = {self.frame_rate}). Lower one of them."
                )


def to_scene_units(options: PhysicalOptions) -> dict[str, Any]:
    """Convert the settings of a real camera to values of the rig's keys, by their names.

    With focal length f, focus distance d, sensor width w and f-number N:
    lens.fov = 2 atan(w / 2 v) in degrees with v = f (with `breathing` f d / (d - f)),
    aperture.radius = f / 2 N in scene units, and the shutter's times in the capture's unit.
    """
    values: dict[str, Any] = {}
    f, d, frame = options.focal_length, options.focus_distance, options.frame_rate
    if options.sensor:
        values["lens.sensor"] = options.sensor
        if f is not None:
            image = 1 / (1 / f - 1 / (1000 * d)) if options.breathing and d is not None else f
            values["lens.fov"] = math.degrees(2 * math.atan(options.sensor[0] / 2 / image))
    if d is not None and options.units_per_metre is not None:
        values["aperture.focus_distance"] = d * options.units_per_metre
        if f is not None and options.f_number is not None:
            values["aperture.radius"] = f / (2 * options.f_number) / 1000 * options.units_per_metre
    if options.seconds_per_unit is not None:
        exposure = options.exposure
        if options.shutter_angle is not None and frame is not None:
            exposure = options.shutter_angle / 360 * 1000 / frame
        for key, value in (("shutter.readout", options.readout), ("shutter.exposure", exposure)):
            if value is not None:
                values[key] = value / 1000 / options.seconds_per_unit
    return values


def apply_units(options: RigOptions, units: PhysicalOptions) -> RigOptions:
    """Set the rig's keys that physical settings determine.

    Args:
        options: the rig.
        units: the physical settings.

    Raises:
        ValueError: A key of the rig and a physical setting both say the same quantity, or a
            physical setting lacks another one.
    """
    for key, value in _rig_values(options, units).items():
        group, name = key.split(".")
        group_options = getattr(options, group)
        default = type(group_options).__dataclass_fields__[name].default
        # The field of view of conf/lens/pinhole.yaml is no choice of the user's either.
        defaults = (default, _PINHOLE_FOV) if key == "lens.fov" else (default,)
        chosen = getattr(group_options, name) not in defaults
        if key not in ("lens.model", "shutter.kind") and chosen:
            source, value = _source(key, units), getattr(group_options, name)
            raise ValueError(
                f"{key} = {value} and physical.{source} = {getattr(units, source)} "
                f"both set it: leave {key} at {default}, or physical.{source} at null."
            )
        changed = dataclasses.replace(group_options, **{name: value})
        options = dataclasses.replace(options, **{group: changed})
    return options


def _rig_values(options: RigOptions, units: PhysicalOptions) -> dict[str, Any]:
    """The values of this rig's keys that the physical settings decide."""
    values = to_scene_units(units)
    if units.focal_length is not None and not (units.sensor or units.f_number):
        raise ValueError("physical.focal_length needs physical.sensor or physical.f_number.")
    if options.lens.model not in ("keep", "pinhole"):
        # Other lenses have keys for their field of view; the focal length is for the aperture.
        values.pop("lens.fov", None)
    elif values.pop("lens.sensor", None):
        if units.focal_length is None:
            raise ValueError("physical.sensor needs physical.focal_length.")
        values["lens.model"] = "pinhole"
    if "aperture.radius" not in values and values.pop("aperture.focus_distance", None):
        if not units.breathing:
            raise ValueError("physical.focus_distance needs physical.f_number.")
    if units.focus_distance is not None and options.aperture.focus_times:
        raise ValueError(
            f"aperture.focus_times = {list(options.aperture.focus_times)} and "
            f"physical.focus_distance = {units.focus_distance} both set the focus: leave one "
            "of them out."
        )
    shutter = options.shutter
    contradictions = {
        "kind": shutter.kind in ("global", "table"),
        "row_step": shutter.row_step != 0,
    }
    for key, holds in contradictions.items():
        if "shutter.readout" in values and holds:
            raise ValueError(
                f"physical.readout = {units.readout} and shutter.{key} = {getattr(shutter, key)} "
                "contradict each other: leave one of them out."
            )
    if options.shutter.kind == "keep" and any(key.startswith("shutter.") for key in values):
        values["shutter.kind"] = "rolling" if "shutter.readout" in values else "global"
    return values


def _source(key: str, units: PhysicalOptions) -> str:
    """The physical key that decides a key of the rig."""
    if key == "shutter.exposure" and units.exposure is None:
        return "shutter_angle"
    names = {"lens.fov": "focal_length", "aperture.radius": "f_number"}
    return names.get(key, key.split(".")[1])


def check_shape(units: PhysicalOptions, films: Iterable[Film]) -> None:
    """Check that the sensor has the shape of every picture, to half a pixel.

    Args:
        units: the physical settings.
        films: sizes of the pictures.

    Raises:
        ValueError: The shapes differ.
    """
    for w, h in {(film.width, film.height) for film in films}:
        if units.sensor and abs(h - w * units.sensor[1] / units.sensor[0]) > 0.5:
            raise ValueError(
                f"physical.sensor must have the shape of the picture, {w} x {h} pixels, got "
                f"{units.sensor[0]} x {units.sensor[1]} mm. Give the part that the picture shows."
            )


def units_record(options: RigOptions, units: PhysicalOptions) -> dict[str, Any]:
    """Physical settings and the rig's values that follow from them, for a manifest.

    Infinity is the text "infinity", because JSON has no such number.

    Args:
        options: the rig.
        units: the physical settings.

    Returns:
        The record; empty without settings.
    """
    if units == PhysicalOptions():
        return {}
    record = {"given": vars(units), "derived": _rig_values(options, units)}
    return {
        "physical": {
            part: {
                name: "infinity" if value == math.inf else value
                for name, value in values.items()
                if value is not None and value is not False and value != ()
            }
            for part, values in record.items()
        }
    }
