"""Film a scene of the paired benchmark through each effect and through all of them at once.

    python -m experiments.composition.film --out DIR --scene living_room_animal [--size 256]

Needs Blender as a Python module, `bpy` 4.5, alone. Every effect is filmed by the benchmark's
held-out cameras at the same instants. The fisheye here is as wide as the training cameras'
pictures, so that it sees nothing that they do not.
"""

import argparse
import dataclasses
import json
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from experiments.blender.blocks import SENSOR_MM, row_times
from experiments.blender.effects import configure, new_camera
from experiments.blender.session import gpu, quality, render
from experiments.paired_benchmark.geometry.render import key, trajectory
from experiments.paired_benchmark.plan import PRESETS, aperture
from experiments.paired_benchmark.scenes import SCENES
from experiments.paired_benchmark.stage import FRAMES, READOUT, cameras


CLIP = FRAMES - 1
EXPOSURE = 1.0  # frames of the clip that a row is exposed for
# A moving camera's motion in a frame of the clip: metres, and radians about the world's axes.
SHIFT, SPIN = Vector((0.02, -0.015, 0.01)), Vector((0.004, -0.003, 0.006))
# As large in the middle as a pinhole of 65 degrees, and as wide: 66 degrees across, 88 from corner
# to corner, where that has 84.
FISHEYE = {
    "model": "blender_fisheye_polynomial",
    "k": [0.0, -0.0354, 2e-4, 0.0, 0.0],
    "sensor_width_mm": SENSOR_MM,
    "sensor_height_mm": SENSOR_MM,
    "fov": 1.6,
}


def effects(size, rig):
    """Blocks of every effect, and whether its camera moves."""
    rolling = row_times(size, FRAMES, READOUT)
    exposed = EXPOSURE / CLIP
    blur = {"row_offset": 0.0, "row_step": 0.0, "exposure": exposed}
    opening = aperture(rig)
    everything = {
        "lens": FISHEYE,
        # Under a fisheye what is in focus is a sphere.
        "aperture": opening | {"focus": "sphere"},
        "shutter": rolling | {"exposure": exposed},
    }
    return {
        "pinhole": ({}, False),
        "fisheye": ({"lens": FISHEYE}, False),
        "depth_of_field": ({"aperture": opening}, False),
        "rolling_shutter": ({"shutter": rolling}, False),
        "motion_blur": ({"shutter": blur | {"direction": "top_to_bottom"}}, False),
        "moving_camera": ({"shutter": rolling}, True),
        "everything": (everything, True),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the capture")
    parser.add_argument("--scene", choices=SCENES, required=True)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--times", type=float, nargs="+", default=[0.3, 0.6])
    chosen = parser.parse_args()
    preset = dataclasses.replace(PRESETS["small"], size=chosen.size)
    gpu()
    stage = SCENES[chosen.scene]()
    quality(chosen.size, chosen.size, chosen.samples)
    camera = new_camera(SENSOR_MM * stage.rig.focal)
    held = [c for c in cameras(stage.rig, preset.cameras, preset.held_cameras, 0) if c[1] == "test"]
    focal, size = stage.rig.focal * chosen.size, chosen.size
    common = {
        **{"w": size, "h": size, "fl_x": focal, "fl_y": focal, "cx": size / 2, "cy": size / 2},
        **{"camera_model": "PINHOLE", "time_unit": "normalised", "color_space": "srgb"},
    }
    bpy.context.scene.render.use_persistent_data = False
    for effect, (blocks, moves) in effects(size, stage.rig).items():
        configure(camera, blocks, READOUT, stage.moving)
        exposed(blocks.get("shutter"))
        frames = []
        for name, split, matrix in held:
            for time in chosen.times:
                path = f"{effect}/{name}/{round(time * CLIP):04d}.png"
                frame = {"file_path": path, "time": time, "camera": name, "split": split}
                frame |= placed(camera, matrix, time * CLIP, moves)
                frames.append(frame)
                if not (chosen.out / path).exists():
                    render(chosen.out / path, time * CLIP, f"{chosen.scene}/{path}")
                print(chosen.out / path, flush=True)
        head = {} if effect == "pinhole" else {"effect": effect, **blocks}
        file = "transforms.json" if effect == "pinhole" else f"{effect}.json"
        text = json.dumps({**common, **head, "frames": frames}, indent=1) + "\n"
        (chosen.out / file).write_text(text)


def exposed(shutter):
    """Tell Cycles how long rows are exposed: the shutter is open for readout and exposure."""
    if not shutter or not shutter["exposure"]:
        return
    scene = bpy.context.scene
    if shutter["row_step"]:
        scene.render.motion_blur_shutter = READOUT + EXPOSURE
        scene.cycles.rolling_shutter_duration = EXPOSURE / (READOUT + EXPOSURE)
    else:
        scene.render.motion_blur_shutter = EXPOSURE
        scene.cycles.rolling_shutter_type = "NONE"


def placed(camera, matrix, frame, moves):
    """Place the camera for a picture at a frame; what the capture says of where it is."""
    camera.animation_data_clear()
    camera.matrix_world = Matrix(matrix.tolist())
    if not moves:
        return {"transform_matrix": np.round(matrix, 9).tolist()}
    key(camera, frame, SHIFT, SPIN)
    return {"trajectory": trajectory(bpy.context.scene, frame)}


if __name__ == "__main__":
    main()
