"""The eight scenes, by name: each fills an empty Blender file and returns its `Stage`."""

import bpy

from experiments.paired_benchmark import basketball, bathroom, living_room, warehouse


def _empty(build):
    def made():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.scene.world = None
        return build()

    return made


SCENES = {
    "basketball_roll": _empty(basketball.roll),
    "basketball_fall": _empty(basketball.fall),
    "warehouse_spheres": _empty(warehouse.spheres),
    "warehouse_cubes": _empty(warehouse.cubes),
    "living_room_bulldozer": _empty(living_room.bulldozer),
    "living_room_animal": _empty(living_room.animal),
    "bathroom_plant": _empty(bathroom.plant),
    "bathroom_box": _empty(bathroom.box),
}
