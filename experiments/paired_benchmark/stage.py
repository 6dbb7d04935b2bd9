"""What a scene of the benchmark is: things, what moves, where cameras stand."""

import math
from typing import Any, NamedTuple

from experiments.blender.rig import aimed, on_walls


# The clip that scenes are animated for, whatever the number of frames that a preset films of it.
FRAMES, FPS = 50, 25
# Frames of motion before the first and after the last one: a shutter looks beyond them.
MARGIN = 3
READOUT = 3.0  # frames of the clip from the first to the last row of a rolling shutter


class Rig(NamedTuple):
    """Where the cameras stand and look: metres and degrees.

    They stand at two heights on a rounded rectangle of half extents `reach` about the origin and
    look at a point near `look_at`; held-out ones stand inside the hull of the others.
    """

    reach: tuple[float, float]
    heights: tuple[float, float]
    look_at: tuple[float, float, float]
    fov: float
    aperture_radius: float
    focus_distance: float

    @property
    def focal(self):
        """Focal length in units of the picture's width."""
        return 0.5 / math.tan(math.radians(self.fov) / 2)


class Stage(NamedTuple):
    """Mesh objects that rest and mesh objects that move, all of them, and the cameras' rig.

    Motion is keyed over frames -MARGIN .. FRAMES - 1 + MARGIN.
    """

    fixed: list[Any]
    moving: list[Any]
    rig: Rig


def cameras(rig, count, held, seed, turn=0.0):
    """(name, split, world_from_camera) of every camera, `turn` of a full circle further along the
    walls; the last `held` are held out."""
    upper = (count - held + 1) // 2
    lower = count - held - upper
    low, high = rig.heights
    places = [on_walls(k / upper + 0.02 + turn, high, rig.reach) for k in range(upper)]
    places += [on_walls((k + 0.5) / lower + turn, low, rig.reach) for k in range(lower)]
    for k in range(held):
        height = high + (low - high) * (k + 1) / (held + 1)
        places.append(on_walls((k + 0.4) / held + turn, height, rig.reach, 0.86))
    splits = ["train"] * (upper + lower) + ["test"] * held
    return aimed(places, splits, rig.look_at, seed)
