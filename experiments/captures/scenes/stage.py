"""What a moving scene is: what rests, what moves, what changes its form, where cameras stand."""

from typing import Any, NamedTuple

import bpy

from experiments.paired_benchmark.stage import FRAMES, Rig


class MovingScene(NamedTuple):
    """Mesh objects that rest, soft things, mesh objects with keys over frames 0 .. FRAMES - 1, and
    the cameras' rig."""

    fixed: list[Any]
    softs: list[Any]
    keyed: list[Any]
    rig: Rig

    @property
    def moving(self):
        """All mesh objects that move."""
        return [made.thing for made in self.softs] + self.keyed

    def pose(self, time):
        """Set everything to a time from 0 to 1."""
        frame = time * (FRAMES - 1)
        bpy.context.scene.frame_set(int(frame // 1), subframe=frame % 1)
        for made in self.softs:
            made.pose(time)


def room_rig(reach, look_at, heights=(0.9, 2.3), fov=65):
    """Cameras along the walls of a room, at two heights."""
    return Rig((reach, reach), heights, look_at, fov, aperture_radius=0.16, focus_distance=3.2)
