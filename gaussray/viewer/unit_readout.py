"""The viewer's camera in photographic units: millimetres, f-number, metres, milliseconds."""

import math
from collections.abc import Mapping
from typing import Any

from gaussray.render.rig.physical_units import PhysicalOptions


# Sensor width in mm where none is configured: full frame.
FULL_FRAME = 36.0


def physical_readout(values: Mapping[str, Any], physical: PhysicalOptions) -> str:
    """The control values on a real camera; empty where the scene's units are unknown.

    The focal length is f = w / (2 tan(fov / 2)) for a pinhole and a sensor of width w, the f-number
    f / 2r for an aperture of radius r.

    Args:
        values: control values by configuration key, in degrees, scene units and the capture's unit
            of time.
        physical: units of the scene, and size of the sensor (36 mm wide if none is given). Lengths
            are left out without `units_per_metre`, times without `seconds_per_unit`.
    """
    parts, width = [], physical.sensor[0] if physical.sensor else FULL_FRAME
    focal, metre = None, physical.units_per_metre
    if values["lens.model"] == "pinhole":
        focal = width / 2 / math.tan(math.radians(values["lens.fov"]) / 2)
    radius = values["aperture.radius"]
    if metre is not None:
        parts += [f"{focal:.3g} mm on {width:g} mm"] if focal else []
        if radius:
            across = 2000 * radius / metre
            parts.append(f"f/{focal / across:.2g}" if focal else f"aperture {across:.3g} mm")
            parts.append(f"focus {values['aperture.focus_distance'] / metre:.3g} m")
    if physical.seconds_per_unit is not None:
        names = {"shutter.exposure": "exposure"}
        if values["shutter.kind"] in ("rolling", "interlaced"):
            names["shutter.readout"] = "readout"
        for key, name in names.items():
            if values[key]:
                parts.append(f"{name} {1000 * values[key] * physical.seconds_per_unit:.3g} ms")
    return " · ".join(parts)
