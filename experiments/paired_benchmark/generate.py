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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np

from experiments.blender import points
from experiments.blender.checks import report, verify, write_json
from experiments.blender.effects import SENSOR_MM, configure, new_camera, row_times
from experiments.blender.session import gpu, quality, read, render, render_depth
from experiments.paired_benchmark.scenes import SCENES
from experiments.paired_benchmark.stage import FRAMES, READOUT, cameras


EFFECTS = ("pinhole", "fisheye", "depth_of_field", "rolling_shutter")
KIND = {"train": "jpg", "test": "png"}  # what is scored stays lossless
FISHEYE = {
    "model": "blender_fisheye_polynomial",
    "k": [0.0, -0.0745, -1.5e-4, -2.5e-5, 2.0e-7],
    "sensor_width_mm": SENSOR_MM,
    "sensor_height_mm": SENSOR_MM,
    "fov": 2.9,
}
POINTS, ON_MOVING = 12000, 3000  # starting points, and those of them on what moves


@dataclass(frozen=True)
class Preset:
    """How much is filmed; `held_cameras` and `held_frames` are for scoring alone.

    `samples` are those of training pictures; what is scored gets `truth_samples`. `paired`: all
    cameras film the effects, not only those held out.
    """

    size: int
    cameras: int
    frames: int
    held_cameras: int
    held_frames: int
    samples: int
    truth_samples: int
    paired: bool


PRESETS = {
    "tiny": Preset(128, 14, 14, 3, 2, samples=16, truth_samples=32, paired=False),
    "small": Preset(256, 24, 24, 4, 3, samples=32, truth_samples=64, paired=False),
    "paper": Preset(512, 50, 50, 5, 5, samples=64, truth_samples=64, paired=True),
}


class Image(NamedTuple):
    """One picture to render, and what its JSON file says of it. `time` runs from 0 to 1."""

    path: str
    blocks: dict
    samples: int
    camera: str
    split: str
    pose: np.ndarray
    time: float
    depth: str | None

    @property
    def frame(self):
        """Where Blender's clock stands."""
        return self.time * (FRAMES - 1)


def main():
    chosen = arguments()
    if chosen.processes > 1:
        sys.exit(on_processes(chosen))
    preset = PRESETS[chosen.preset]
    given = {name: getattr(chosen, name) for name in vars(preset) if hasattr(chosen, name)}
    preset = replace(preset, **{name: value for name, value in given.items() if value is not None})
    check(preset)
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


def check(preset):
    if preset.frames < 4 or preset.cameras - preset.held_cameras < 4:
        sys.exit("--frames must be at least 4, and so many cameras must be left to learn from.")
    if preset.held_frames > preset.frames // 2:
        sys.exit("--held-frames must be at most half of --frames.")


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
    stage = SCENES[name]()
    focal = 0.5 / np.tan(np.radians(stage.rig.fov) / 2)
    images, files = plan(chosen, preset, name, stage.rig, focal)
    for file, content in files.items():
        write_json(out / file, content)
    own = images[chosen.part :: chosen.parts]
    missing = [image for image in own if not whole(out, image)]
    camera = new_camera(SENSOR_MM * focal)
    quality(preset.size, preset.size, preset.samples)
    begun = time.monotonic()
    for done, image in enumerate(missing, 1):
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
        start(out, images, stage, focal * preset.size, chosen.seed)
    verify(out)
    report(out)


def whole(out, image):
    return (out / image.path).exists() and (not image.depth or (out / image.depth).exists())


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


def plan(chosen, preset, name, rig, focal):
    """Every picture of a scene and the JSON files that list them."""
    size = preset.size
    blocks = {
        "pinhole": {},
        "fisheye": {"lens": FISHEYE},
        "depth_of_field": {"aperture": aperture(rig)},
        "rolling_shutter": {"shutter": row_times(size, FRAMES, READOUT)},
    }
    common = {
        **{"w": size, "h": size, "fl_x": focal * size, "fl_y": focal * size},
        **{"cx": size / 2, "cy": size / 2, "camera_model": "PINHOLE"},
        **{"time_unit": "normalised", "color_space": "srgb"},
    }
    info = {"scene": name, "preset": vars(preset), "blender": bpy.app.version_string}
    placed = cameras(rig, preset.cameras, preset.held_cameras, chosen.seed)
    images, files = [], {}
    for effect in chosen.effects:
        made = [
            picture(preset, effect, blocks[effect], index, *camera)
            for camera in placed
            for index in times(preset, effect)
            if effect == "pinhole" or preset.paired or camera[1] == "test"
        ]
        images += made
        head = {"ply_file_path": "points3d.ply", "info": info}
        if effect != "pinhole":
            head = {"effect": effect, **blocks[effect], "samples": preset.truth_samples}
        file = "transforms.json" if effect == "pinhole" else f"{effect}.json"
        files[file] = {**common, **head, "frames": [listed(image) for image in made]}
    return images, files


def times(preset, effect):
    """Indices of the frames that an effect is filmed at: all whose rows see within the clip."""
    every = range(preset.frames)
    if effect != "rolling_shutter":
        return every
    step = (FRAMES - 1) / (preset.frames - 1)
    return [i for i in every if READOUT / 2 <= i * step <= FRAMES - 1 - READOUT / 2]


def held(preset):
    """Indices of the frames that no camera learns from, evenly spread, ends excluded."""
    place = np.linspace(0, preset.frames - 1, preset.held_frames + 2)[1:-1]
    return set(np.round(place).astype(int).tolist())


def picture(preset, effect, blocks, index, camera, split, pose):
    split = "test" if index in held(preset) else split
    folder = "images" if effect == "pinhole" else effect
    scored = split == "test" or effect != "pinhole"
    return Image(
        path=f"{folder}/{camera}/{index:04d}.{KIND['test' if scored else 'train']}",
        blocks=blocks,
        samples=preset.truth_samples if scored else preset.samples,
        camera=camera,
        split=split,
        pose=pose,
        time=index / (preset.frames - 1),
        depth=f"depth/{camera}/{index:04d}.png" if not blocks and split == "test" else None,
    )


def aperture(rig):
    return {
        **{"radius": rig.aperture_radius, "focus_distance": rig.focus_distance},
        **{"focus": "plane", "blades": 0, "rotation": 0.0, "ratio": 1.0},
    }


def listed(image):
    return {
        "file_path": image.path,
        "transform_matrix": image.pose.round(9).tolist(),
        "time": image.time,
        "camera": image.camera,
        "split": image.split,
        **({"depth_file_path": image.depth} if image.depth else {}),
    }


if __name__ == "__main__":
    main()
