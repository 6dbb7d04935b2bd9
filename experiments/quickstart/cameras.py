"""The cameras: where they stand, and the blocks of each optical effect."""

import math

import numpy as np

from experiments.blender.blocks import SENSOR_MM, row_times
from experiments.blender.rig import aimed, on_walls


FOV = math.radians(65)  # pinhole, horizontal
LENS_MM = SENSOR_MM / (2 * math.tan(FOV / 2))
REACH = (2.85, 2.85)  # just inside the walls
LOOK_AT = (0.0, 0.0, 1.0)

LENS = {
    "model": "blender_fisheye_polynomial",
    "k": [0.0, -0.0745, -1.5e-4, -2.5e-5, 2.0e-7],
    "sensor_width_mm": SENSOR_MM,
    "sensor_height_mm": SENSOR_MM,
    "fov": 2.9,
}
APERTURE = {
    "radius": 0.09,
    "focus_distance": 2.3,
    "focus": "plane",
    "blades": 0,
    "rotation": 0.0,
    "ratio": 1.0,
}
READOUT = 4.0  # frames from the first row to the last


def rig(count, seed):
    """(name, split, world_from_camera) of every camera.

    Two rings along the walls to learn from; the held-out cameras stand inside their convex hull.
    """
    held = max(1, round(count * 3 / 16))
    upper = (count - held + 1) // 2
    lower = count - held - upper
    places = [on_walls(k / upper + 0.02, 2.45, REACH) for k in range(upper)]
    places += [on_walls((k + 0.5) / lower, 0.85, REACH) for k in range(lower)]
    places += [on_walls((k + 0.4) / held, 1.95 - 0.35 * k, REACH, 0.86) for k in range(held)]
    splits = ["train"] * (upper + lower) + ["test"] * held
    return aimed(places, splits, LOOK_AT, seed)


def intrinsics(size):
    focal = LENS_MM / SENSOR_MM * size
    return {"w": size, "h": size, "fl_x": focal, "fl_y": focal, "cx": size / 2, "cy": size / 2}


def effects(size, frames, count=8):
    """Name -> (blocks of its file, frames rendered). Every row time lies inside the clip."""
    every = list(range(0, frames, 2))
    margin = math.ceil(READOUT / 2)
    inside = np.unique(np.linspace(margin, frames - 1 - margin, count).round().astype(int)).tolist()
    return {
        "fisheye": ({"lens": LENS}, every),
        "depth_of_field": ({"aperture": APERTURE}, every),
        "rolling_shutter": ({"shutter": row_times(size, frames, READOUT)}, inside),
    }
