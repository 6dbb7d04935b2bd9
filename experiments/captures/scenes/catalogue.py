"""The moving scenes, by name: each fills an empty Blender file and returns its `MovingScene`."""

import bpy

from experiments.captures.scenes import (
    falling_boxes,
    fan_pendulum,
    soft_four,
    soft_one,
    soft_three,
    soft_two,
)


def _empty(build):
    def made():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.scene.world = None
        return build()

    return made


SCENES = {
    "soft_one": _empty(soft_one.scene),
    "falling_boxes": _empty(falling_boxes.scene),
    "soft_two": _empty(soft_two.scene),
    "fan_pendulum": _empty(fan_pendulum.scene),
    "soft_three": _empty(soft_three.scene),
    "soft_four": _empty(soft_four.scene),
}
