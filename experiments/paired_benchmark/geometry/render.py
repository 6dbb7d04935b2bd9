"""Blender's side: a paired capture whose pictures tell the ray and the time of every pixel.

    python -m experiments.paired_benchmark.geometry.render DIR [--size 64]

Needs nothing but Blender as a Python module, `bpy` 4.5, and its numpy. The camera stands in a
closed box that moves along x, and whose surface writes four passes: where the ray hits it ("hit"),
where the ray comes from ("incoming"), and how far the box has gone by then ("moved" and its
"square"). One sample of a pixel is one exact ray.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import bpy
from mathutils import Euler, Vector

from experiments.blender import effects
from experiments.blender.blocks import SENSOR_MM
from experiments.blender.session import silence
from experiments.paired_benchmark.geometry.blocks import POSITION, blocks
from experiments.paired_benchmark.geometry.cases import CLIP, SPEED, cases
from experiments.paired_benchmark.stage import READOUT


BOX = 10.0  # metres from wall to wall
REACH = 6  # frames before and after the picture's own that box and camera are keyed for
MEAN_SAMPLES = 1024  # per pixel, for the mean of an exposure
CAMERA_STEPS = 3  # 2^3 + 1 poses while the shutter is open
# No axis of the camera is one of the world's.
PLACE, TURN = Vector((0.31, -0.22, 0.17)), Euler((1.1, 0.35, -2.2))
# A moving camera's motion in a frame.
SHIFT, SPIN = Vector((0.06, 0.11, -0.09)), Euler((0.05, -0.08, 0.12))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of the capture")
    parser.add_argument("--size", type=int, default=64, help="shorter side of the pictures")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for case in cases(args.size):
        document = render(case, args.out)
        (args.out / f"{case.name}.json").write_text(json.dumps(document, indent=1) + "\n")


def render(case, out):
    """Render a case; returns its document of the capture."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    quality(scene, case)
    box = moving_box(case.frame)
    document: dict[str, Any]
    document = planned(scene, case, box) if case.document else configured(scene, case)
    (frame,) = document["frames"]
    frame["file_path"] = f"{case.name}.exr"
    shoot(scene, out / frame["file_path"], case.frame)
    if document.get("shutter", {}).get("exposure"):
        scene.cycles.samples = scene.cycles.sample_subset_length = MEAN_SAMPLES
        shoot(scene, out / f"{case.name}.mean.exr", case.frame)
    info = {"blender": bpy.app.version_string}
    return document | {"effect": case.name, "samples": 1, "info": info}


def configured(scene, case):
    """Set Blender's camera by its own properties; returns the document that says the same."""
    camera = effects.new_camera(case.settings.get("camera.lens", 50.0))
    camera.location, camera.rotation_euler = PLACE, TURN
    if case.moving:
        key(camera, case.frame, SHIFT, SPIN)
    roots = {"camera": camera.data, "render": scene.render, "cycles": scene.cycles}
    for path, value in case.settings.items():
        root, *between, name = path.split(".")
        owner = roots[root]
        for part in between:
            owner = getattr(owner, part)
        setattr(owner, name, value)
    frame = {"time": case.frame / CLIP, "camera": "camera", "split": "test"}
    if case.moving:
        frame["trajectory"] = trajectory(scene, case.frame)
    else:
        frame["transform_matrix"] = pose(scene, case.frame)
    return blocks(scene, CLIP, case.through_filter) | {"frames": [frame]}


def planned(scene, case, box):
    """Tell Blender what a document of the benchmark says, by the benchmark's own code."""
    document = case.document
    camera = effects.new_camera(document["fl_x"] / document["w"] * SENSOR_MM)
    effects.configure(camera, document, READOUT, [box])
    (frame,) = document["frames"]
    camera.matrix_world = [*zip(*frame["transform_matrix"], strict=True)]
    return document | {"film": {"filter": "center"}, "frames": [{**frame}]}


def quality(scene, case):
    """One sample of each pixel: the first, through its centre, or the second, anywhere in it."""
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    scene.render.resolution_x, scene.render.resolution_y = case.resolution
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.filter_width = 0.01  # its least: what a mean is taken through
    scene.cycles.samples = 1 + case.through_filter
    scene.cycles.use_sample_subset = True
    scene.cycles.sample_offset, scene.cycles.sample_subset_length = int(case.through_filter), 1


def moving_box(frame):
    """A box around the origin at `frame`, lit by its passes."""
    bpy.ops.mesh.primitive_cube_add(size=BOX)
    box = bpy.context.object
    key(box, frame, Vector((SPEED, 0, 0)))
    material = bpy.data.materials.new("instrument")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    geometry, inside = nodes.new("ShaderNodeNewGeometry"), nodes.new("ShaderNodeTexCoord")
    moved, square = nodes.new("ShaderNodeVectorMath"), nodes.new("ShaderNodeVectorMath")
    moved.operation, square.operation = "SUBTRACT", "MULTIPLY"
    links.new(geometry.outputs["Position"], moved.inputs[0])
    links.new(inside.outputs["Object"], moved.inputs[1])
    for side in square.inputs[:2]:
        links.new(moved.outputs[0], side)
    passes = {
        "hit": geometry.outputs["Position"],
        "incoming": geometry.outputs["Incoming"],
        "moved": moved.outputs[0],
        "square": square.outputs[0],
    }
    for name, value in passes.items():
        aov = bpy.context.view_layer.aovs.add()
        aov.name = name
        output = nodes.new("ShaderNodeOutputAOV")
        output.aov_name = name
        links.new(value, output.inputs["Color"])
    light, surface = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    links.new(geometry.outputs["Position"], light.inputs["Color"])
    links.new(light.outputs[0], surface.inputs["Surface"])
    box.data.materials.append(material)
    return box


def key(thing, frame, shift, spin=(0, 0, 0)):
    """Even motion: `shift` metres and `spin` Euler angles a frame, as it stands at `frame`."""
    place, turn = thing.location.copy(), Vector(thing.rotation_euler)
    for step in (-REACH, REACH):
        thing.location = place + step * Vector(shift)
        thing.rotation_euler = turn + step * Vector(spin)
        thing.keyframe_insert("location", frame=frame + step)
        thing.keyframe_insert("rotation_euler", frame=frame + step)
    for curve in thing.animation_data.action.fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"


def trajectory(scene, frame):
    """The poses between which Cycles moves the camera while the shutter is open."""
    camera, time = scene.camera, scene.render.motion_blur_shutter
    camera.cycles.motion_steps = CAMERA_STEPS
    count = 2**CAMERA_STEPS
    middle = frame + POSITION[scene.render.motion_blur_position] * time
    instants = [middle + time * (k / count - 0.5) for k in range(count + 1)]
    return [{"time": t / CLIP, "transform_matrix": pose(scene, t)} for t in instants]


def pose(scene, frame):
    """Camera to world at a frame, which may be fractional."""
    scene.frame_set(int(frame // 1), subframe=frame % 1)
    return [list(row) for row in scene.camera.matrix_world]


def shoot(scene, path, frame):
    scene.frame_set(int(frame // 1), subframe=frame % 1)
    scene.render.filepath = str(path.resolve())
    with silence():
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
