"""Film a scene of the paired benchmark as a person's cameras would: a video of each, no more.

    python -m experiments.videos.film --out DIR

Cameras stand on an arc about what happens, low and high in turn, so that the next of a row is 15
degrees away. Their true places go to DIR/truth.json, which no step of a reconstruction reads. Needs
`bpy` 4.5 and ffmpeg.
"""

import argparse
import json
import math
import subprocess
import time
from pathlib import Path

import bpy

from experiments.blender.blocks import SENSOR_MM
from experiments.blender.effects import configure, new_camera
from experiments.blender.paint import grain
from experiments.blender.rig import aimed, on_walls
from experiments.blender.session import quality, render, silence
from experiments.paired_benchmark.scenes import SCENES
from experiments.paired_benchmark.stage import FPS, READOUT


BEGIN, ARC = 0.46, 0.44  # turns about the middle: where the arc begins, and how far it goes


def main():
    chosen = arguments()
    with silence():
        stage = SCENES[chosen.scene]()
    for painted in bpy.data.materials:
        grain(painted)
    width, height = chosen.size
    camera = new_camera(SENSOR_MM * stage.rig.focal)
    quality(width, height, chosen.samples)
    configure(camera, {}, READOUT, stage.moving)
    bpy.context.scene.render.use_persistent_data = True
    views = arc(stage.rig, chosen.cameras)
    chosen.out.mkdir(parents=True, exist_ok=True)
    tell(chosen.out / "truth.json", views, width, stage.rig.focal * width)
    shots = [(k, *view) for k in range(chosen.instants) for view in views]
    begun = time.monotonic()
    for done, (k, name, _, pose) in enumerate(shots, 1):
        path = chosen.out / "frames" / name / f"{k:04d}.png"
        if not path.exists():
            camera.matrix_world = pose.T.tolist()
            render(path, chosen.every * k, f"{chosen.scene}/{name}/{k}")
        print(f"{done}/{len(shots)} {path}  {time.monotonic() - begun:.0f} s", flush=True)
    for name, _, _ in views:
        encode(chosen.out, name, FPS / chosen.every)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--scene", choices=SCENES, default="living_room_bulldozer")
    parser.add_argument("--size", type=int, nargs=2, default=(640, 480), metavar=("W", "H"))
    parser.add_argument("--cameras", type=int, default=22)
    parser.add_argument("--instants", type=int, default=5)
    parser.add_argument("--every", type=int, default=3, help="frames of the clip between instants")
    parser.add_argument("--samples", type=int, default=4, help="per pixel")
    return parser.parse_args()


def arc(rig, count):
    """(name, split, world_from_camera): low and high in turn."""
    low, high = rig.heights
    places = [
        on_walls(BEGIN + ARC * k / (count - 1), high if k % 2 else low, rig.reach)
        for k in range(count)
    ]
    return aimed(places, ["train"] * count, rig.look_at, 0)


def tell(path, views, width, focal):
    """The true cameras: pixels, degrees, and camera to world in metres (x right, y up)."""
    told = {
        "focal": focal,
        "across": math.degrees(2 * math.atan(width / 2 / focal)),
        "cameras": {name: pose.round(9).tolist() for name, _, pose in views},
    }
    path.write_text(json.dumps(told, indent=1) + "\n")


def encode(out, name, rate):
    """A video such as cameras write: H.264, 4:2:0."""
    command = ["ffmpeg", "-loglevel", "error", "-y", "-framerate", f"{rate:g}"]
    command += ["-i", f"{out}/frames/{name}/%04d.png", "-c:v", "libx264", "-crf", "16"]
    subprocess.run([*command, "-pix_fmt", "yuv420p", f"{out}/{name}.mp4"], check=True)


if __name__ == "__main__":
    main()
