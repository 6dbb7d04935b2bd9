"""Render the paired benchmark: eight dynamic scenes, each filmed under four effects.

    python -m experiments.paired_benchmark.generate --out DIR --preset tiny
    python -m experiments.paired_benchmark.generate --out DIR --preset paper --shard 3/16

Needs nothing but Blender as a Python module, `bpy` 4.5, and its numpy. Every folder DIR/<scene> is
a paired capture. If stopped, it goes on where it was; several machines may share DIR, each with
its --shard. Cycles uses a GPU if it finds one.
"""

import argparse
import subprocess
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import bpy
import numpy as np

from experiments.blender import points
from experiments.blender.blocks import SENSOR_MM
from experiments.blender.checks import report, verify, write_json
from experiments.blender.effects import configure, new_camera
from experiments.blender.session import gpu, quality, read, render, render_depth, silence
from experiments.paired_benchmark.plan import EFFECTS, PRESETS, plan
from experiments.paired_benchmark.scenes import SCENES
from experiments.paired_benchmark.stage import READOUT


POINTS, ON_MOVING = 12000, 3000  # starting points, and those of them on what moves


def main():
    chosen = arguments()
    if chosen.processes > 1:
        sys.exit(on_processes(chosen))
    preset = PRESETS[chosen.preset]
    given = {name: getattr(chosen, name) for name in vars(preset) if hasattr(chosen, name)}
    preset = replace(preset, **{name: value for name, value in given.items() if value is not None})
    if problem := preset.problem():
        sys.exit(problem)
    kind = gpu()
    print(f"Cycles renders on {kind or 'the CPU: it finds no GPU'}.", flush=True)
    for number, name in enumerate(chosen.scenes):
        print(f"{name} ({number + 1} of {len(chosen.scenes)})", flush=True)
        film(chosen, preset, name)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of all captures")
    parser.add_argument("--preset", choices=PRESETS, default="tiny")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--effects", nargs="+", choices=EFFECTS, default=list(EFFECTS))
    parser.add_argument("--size", type=int, help="width and height in pixels")
    parser.add_argument("--cameras", type=int)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--held-cameras", type=int, help="0: the paper's protocol")
    parser.add_argument("--held-frames", type=int, help="0: the paper's protocol")
    parser.add_argument("--samples", type=int, help="per pixel of training pictures")
    parser.add_argument("--truth-samples", type=int, help="per pixel of pictures that are scored")
    parser.add_argument("--effect-step", type=int, help="effects are filmed at every Nth frame")
    unset = {"action": "store_false", "default": None}
    parser.add_argument("--held-effects", dest="paired", help="only by held-out cameras", **unset)
    parser.add_argument("--no-depth", dest="depth", help="no pictures of depth", **unset)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1, help="on this machine")
    parser.add_argument(
        "--shard", default="0/1", help="I/N: this process renders every Nth picture"
    )
    chosen = parser.parse_args()
    try:
        chosen.part, chosen.parts = (int(number) for number in chosen.shard.split("/"))
    except ValueError:
        parser.error(f"--shard must be I/N, such as 0/4, got {chosen.shard}.")
    if not 0 <= chosen.part < chosen.parts:
        parser.error(f"--shard must be I/N with I from 0 to N - 1, got {chosen.shard}.")
    if "pinhole" not in chosen.effects:
        parser.error("--effects must hold pinhole, which everything is learnt from.")
    return chosen


def on_processes(chosen):
    """This command once for each process, with a share of the pictures."""
    own = [word for word in sys.argv[1:]]
    place = own.index("--processes")
    del own[place : place + 2]
    if "--shard" in own:
        place = own.index("--shard")
        del own[place : place + 2]
    total = chosen.parts * chosen.processes
    command = [sys.executable, "-m", "experiments.paired_benchmark.generate", *own, "--shard"]
    shards = range(chosen.part * chosen.processes, (chosen.part + 1) * chosen.processes)
    running = [subprocess.Popen([*command, f"{shard}/{total}"]) for shard in shards]
    return max(process.wait() for process in running)


def film(chosen, preset, name):
    """Render what this shard has to of a scene, and what needs all of its pictures if they are
    there."""
    out = chosen.out / name
    out.mkdir(parents=True, exist_ok=True)
    # Cameras are known only when the room is built; so is what is missing.
    with silence():
        stage = SCENES[name]()
    info = {"scene": name, "preset": vars(preset), "blender": bpy.app.version_string}
    images, files = plan(preset, stage.rig, chosen.effects, info, chosen.seed)
    for file, content in files.items():
        write_json(out / file, content)
    own = images[chosen.part :: chosen.parts]
    missing = [image for image in own if not whole(out, image)]
    camera = new_camera(SENSOR_MM * stage.rig.focal)
    quality(preset.size, preset.size, preset.samples)
    begun = time.monotonic()
    for done, (last, image) in enumerate(pairwise([None, *missing]), 1):
        bpy.context.scene.render.use_persistent_data = like(last, image)
        shoot(out, image, camera, stage.moving, f"{chosen.seed} {name}/{image.path}")
        passed = time.monotonic() - begun
        left = passed / done * (len(missing) - done)
        print(
            f"{done}/{len(missing)} {out / image.path}  {passed:.0f} s, {left:.0f} s left",
            flush=True,
        )
    if not all(whole(out, image) for image in images):
        print(f"{out}: other shards have pictures to render yet.", flush=True)
        return
    if not (out / "points3d.ply").exists():
        start(out, images, stage, stage.rig.focal * preset.size, chosen.seed)
    verify(out)
    report(out)


def whole(out, image):
    return (out / image.path).exists() and (not image.depth or (out / image.depth).exists())


def like(last, image):
    """Whether Cycles may keep what it built for the last picture. To build it anew takes a GPU
    longer than to render; but what is kept hides a change of motion steps, or of passes."""
    return last is not None and not last.depth and effect_of(last) == effect_of(image)


def effect_of(image):
    return image.path.split("/")[0]


def shoot(out, image, camera, moving, label):
    bpy.context.scene.cycles.samples = image.samples
    configure(camera, image.blocks, READOUT, moving)
    camera.matrix_world = image.pose.T.tolist()
    if not (out / image.path).exists():
        render(out / image.path, image.frame, label)
    if image.depth:
        render_depth(out / image.depth, image.frame)


def start(out, images, stage, focal, seed):
    """Surface points of the first frame, as the training cameras see them."""
    views = [
        (image.pose, read(out / image.path))
        for image in images
        if not image.blocks and image.time == 0 and image.split == "train"
    ]
    groups = [(stage.moving, ON_MOVING), (stage.fixed, POINTS - ON_MOVING)]
    found = points.sample(groups, views, focal, np.random.default_rng(seed))
    points.write_ply(out / "points3d.ply", *found)


if __name__ == "__main__":
    main()
