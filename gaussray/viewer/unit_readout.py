"""The page's controls as a photographer says them: millimetres, f-numbers, metres, milliseconds."""

import math
from collections.abc import Mapping
from typing import Any

from gaussray.render.rig.physical_units import PhysicalOptions


# Width in mm of the sensor that is thought of where none is given: full frame.
FULL_FRAME = 36.0


def spoken(values: Mapping[str, Any], given: PhysicalOptions) -> str:
    """What the controls amount to on a real camera; empty where nothing is known of units.

    f = w / (2 tan(fov / 2)) for a pinhole of a sensor w wide, N = f / 2r for an opening of radius r
    (physical.units_per_metre), times in ms (physical.seconds_per_unit).
    """
    told, width = [], given.sensor[0] if given.sensor else FULL_FRAME
    focal, metre = None, given.units_per_metre
    if values["lens.model"] == "pinhole":
        focal = width / 2 / math.tan(math.radians(values["lens.fov"]) / 2)
    radius = values["aperture.radius"]
    if metre is not None:
        told += [f"{focal:.3g} mm on {width:g} mm"] if focal else []
        if radius:
            across = 2000 * radius / metre
            told.append(f"f/{focal / across:.2g}" if focal else f"opening {across:.3g} mm")
            told.append(f"focus {values['aperture.focus_distance'] / metre:.3g} m")
    if given.seconds_per_unit is not None:
        names = {"shutter.exposure": "exposed"}
        if values["shutter.kind"] in ("rolling", "interlaced"):
            names["shutter.readout"] = "readout"
        for key, name in names.items():
            if values[key]:
                told.append(f"{name} {1000 * values[key] * given.seconds_per_unit:.3g} ms")
    return " · ".join(told)
