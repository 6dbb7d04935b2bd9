"""Film a few pictures of one scene, to look at while building it.

python -m experiments.paired_benchmark.look SCENE --out DIR [--size 256] [--cameras 3] [--frames 4]
"""

import argparse
from pathlib import Path

import numpy as np

from experiments.blender.blocks import SENSOR_MM
from experiments.blender.effects import configure, new_camera
from experiments.blender.session import quality, render
from experiments.paired_benchmark.scenes import SCENES
from experiments.paired_benchmark.stage import FRAMES, READOUT, cameras


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", choices=SCENES)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--cameras", type=int, default=3)
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--samples", type=int, default=16)
    chosen = parser.parse_args()
    stage = SCENES[chosen.scene]()
    lens_mm = SENSOR_MM / (2 * np.tan(np.radians(stage.rig.fov) / 2))
    camera = new_camera(lens_mm)
    quality(chosen.size, chosen.size, chosen.samples)
    configure(camera, {}, READOUT, stage.moving)
    for name, _, pose in cameras(stage.rig, 16, 3, 0)[:: max(16 // chosen.cameras, 1)]:
        camera.matrix_world = pose.T.tolist()
        for frame in np.linspace(0, FRAMES - 1, chosen.frames):
            path = chosen.out / f"{chosen.scene}_{name}_{frame:05.2f}.png"
            render(path, frame, str(path.name))
            print(path, flush=True)


if __name__ == "__main__":
    main()
