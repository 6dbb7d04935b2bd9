"""Render captures of moving scenes: cloth, figures that walk, blobs, things that fall or turn.

    python -m experiments.captures.soft_scenes SCENE ... --out DIR
    python -m experiments.captures.soft_scenes SCENE --out DIR --look
    python -m experiments.captures.soft_scenes SCENE --out DIR --rig moving

Needs nothing but Blender as a Python module, `bpy` 4.5, and its numpy. Every folder DIR/<scene> is
a paired capture: 13 training cameras and 3 held-out ones that stand still, 20 times each, and
between these 3 more times at the held-out cameras. A command that was stopped goes on where it was.
With `--rig moving`, every camera moves along the walls meanwhile (folder DIR/<scene>_moving), and
`still/` has the held-out pictures without what moves, which tell what moves in the others; with
`--rig mixed`, each third training camera does, and the others stand still (folder
DIR/<scene>_mixed); with `--rig walk`, one of these cameras does, alone, and each fifth picture is
held out (folder DIR/<scene>_walk); with `--rig dome`, cameras stand around the soft things alone,
on black (folder DIR/<scene>_dome); with `--rig single`, one camera does, at another place for every
picture, each of a time of its own (folder DIR/<scene>_single): `--cameras` is the number of
pictures. With `--late P`, each training camera is late by up to P percent of the time between two
pictures, for cameras that nothing synchronises (folder DIR/<scene>_late, without points).
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np

from experiments.blender import points
from experiments.blender.blocks import SENSOR_MM
from experiments.blender.checks import report, verify, write_json
from experiments.blender.effects import configure, new_camera
from experiments.blender.rig import on_dome
from experiments.blender.session import quality, read, render, silence
from experiments.captures.scenes.catalogue import SCENES
from experiments.paired_benchmark.plan import listed
from experiments.paired_benchmark.stage import FRAMES, cameras


POINTS, ON_MOVING = 12000, 3000  # starting points, and those of them on what moves
BETWEEN = 3  # times in the middle between two frames, for held-out cameras alone
RIGS = ("walls", "moving", "mixed", "walk", "dome", "single")
EMPTIED = "still"  # folder of the pictures without what moves
WALKER, HOLD = 3, 5  # the camera that moves alone; of so many of its pictures one is held out
DRIFT = 0.08  # of a full circle, that moving cameras cover
MIXED = 3  # of so many training cameras of a mixed rig one moves


@dataclass(frozen=True)
class Plan:
    """How much is rendered, and how well."""

    size: int = 256
    cameras: int = 16
    held_cameras: int = 3
    frames: int = 20
    samples: int = 24
    truth_samples: int = 64
    late: int = 0
    rig: str = "walls"


class Picture(NamedTuple):
    """One picture to render, and what transforms.json says of it; `time` runs from 0 to 1."""

    path: str
    camera: str
    split: str
    pose: np.ndarray
    time: float
    depth: None = None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", choices=SCENES)
    parser.add_argument("--out", type=Path, required=True, help="folder of all captures")
    parser.add_argument("--threads", type=int, default=0, help="0: all cores")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--look", action="store_true", help="few pictures, no capture")
    parser.add_argument("--rig", choices=RIGS, default=RIGS[0])
    for name, value in vars(Plan()).items():
        if isinstance(value, int):
            parser.add_argument(f"--{name.replace('_', '-')}", type=int, default=value)
    chosen = parser.parse_args()
    if chosen.late and chosen.rig != "walls":
        parser.error("--late is for cameras that stand still (--rig walls)")
    plan = Plan(**{name: getattr(chosen, name) for name in vars(Plan())})
    for name in chosen.scenes:
        capture(chosen, plan, name)


def capture(chosen, plan, name):
    """Render what is missing of a scene's capture."""
    with silence():
        scene = SCENES[name]()
    if plan.rig in ("dome", "single"):
        for thing in scene.fixed:
            thing.hide_render = True
        bpy.context.scene.render.film_transparent = True  # black, as pictures are stored
        scene = scene._replace(fixed=[])
    if plan.rig != "walls":
        name += f"_{plan.rig}"
    if plan.late:
        name += "_late"
    out = chosen.out / name
    pictures = plan_pictures(plan, scene.rig, chosen.seed)
    if chosen.look:
        seen = sorted({picture.camera for picture in pictures})[::3]
        times = {pictures[k * (plan.frames - 1) // 4].time for k in range(5)}
        pictures = [p for p in pictures if p.camera in seen and p.time in times]
    else:
        out.mkdir(parents=True, exist_ok=True)
        write_json(out / "transforms.json", document(plan, scene.rig, name, pictures))
    emptied = without_motion(pictures) if plan.rig == "moving" else []
    missing = [picture for picture in [*pictures, *emptied] if not (out / picture.path).exists()]
    prepare(plan, scene.rig, chosen.threads)
    begun = time.monotonic()
    for done, picture in enumerate(missing, 1):
        shoot(out, plan, scene, picture, f"{chosen.seed} {name}/{picture.path}")
        passed = time.monotonic() - begun
        left = passed / done * (len(missing) - done)
        print(
            f"{done}/{len(missing)} {out / picture.path}  {passed:.0f} s, {left:.0f} s left",
            flush=True,
        )
    if chosen.look:
        return
    if not plan.late and not (out / "points3d.ply").exists():
        start(out, pictures, scene, scene.rig.focal * plan.size, chosen.seed)
    verify(out)
    report(out)


def plan_pictures(plan, rig, seed):
    """Every picture of a capture: all cameras at all times, then times between at held-out ones."""
    if plan.rig == "single":
        return pictures_of_one_camera(plan, rig, seed)
    if plan.rig == "walk":
        return pictures_on_the_way(plan, rig, seed)
    last = plan.frames - 1
    between = [k * last // (BETWEEN + 1) + 0.5 for k in range(1, BETWEEN + 1)]
    placed = {
        index: placed_at(plan, rig, seed, index / last) for index in (*range(last + 1), *between)
    }
    names = [(camera, split) for camera, split, _ in placed[0]]
    indices = [(k, index) for k in range(len(names)) for index in range(plan.frames)]
    indices += [(k, i) for k, (_, split) in enumerate(names) if split == "test" for i in between]
    late = np.random.default_rng(seed).uniform(0, plan.late / 100, len(names))
    pictures = []
    for k, index in indices:
        name, split, pose = placed[index][k]
        path = f"images/{name}/{index:04.1f}.jpg".replace(".0.", ".")
        moment = index + (late[k] if split == "train" else 0.0)
        pictures.append(Picture(path, name, split, pose, moment / last))
    return pictures


def pictures_on_the_way(plan, rig, seed):
    """A picture of every time by one camera, which moves."""
    last, pictures = plan.frames - 1, []
    for k in range(plan.frames):
        placed = placed_at(plan, rig, seed, k / last)
        name, _, pose = placed[WALKER % len(placed)]
        split = "test" if k % HOLD == HOLD // 2 else "train"
        pictures.append(Picture(f"images/{k:03d}.jpg", name, split, pose, k / last))
    return pictures


def without_motion(pictures):
    """The held-out pictures once more, without what moves."""
    held = [picture for picture in pictures if picture.split == "test"]
    return [p._replace(path=p.path.replace("images", EMPTIED, 1)) for p in held]


def pictures_of_one_camera(plan, rig, seed):
    """A picture of every place of a dome, in random order, each at a time of its own."""
    places = placed_at(plan, rig, seed, 0.0)
    order = np.random.default_rng(seed).permutation(plan.cameras)
    return [
        Picture(f"images/{split}/{k:03d}.jpg", split, split, places[row][2], k / (plan.cameras - 1))
        for k, row in enumerate(order)
        for split in [places[row][1]]
    ]


def placed_at(plan, rig, seed, time):
    """(name, split, world_from_camera) of every camera at a time."""
    if plan.rig in ("dome", "single"):
        return on_dome(plan.cameras, plan.held_cameras, rig.look_at, 0.9 * rig.reach[0], seed)
    placed = cameras(rig, plan.cameras, plan.held_cameras, seed, 0.0)
    if plan.rig == "walls":
        return placed
    moved = cameras(rig, plan.cameras, plan.held_cameras, seed, DRIFT * time)
    if plan.rig != "mixed":
        return moved
    walking = [k for k, (_, split, _) in enumerate(placed) if split == "train"][::MIXED]
    return [moved[k] if k in walking else one for k, one in enumerate(placed)]


def document(plan, rig, name, pictures):
    """The content of transforms.json."""
    size, focal = plan.size, rig.focal * plan.size
    return {
        **{"w": size, "h": size, "fl_x": focal, "fl_y": focal, "cx": size / 2, "cy": size / 2},
        **{"camera_model": "PINHOLE", "time_unit": "normalised", "color_space": "srgb"},
        **({} if plan.late else {"ply_file_path": "points3d.ply"}),
        "info": {"scene": name, "plan": vars(plan), "blender": bpy.app.version_string},
        "frames": [listed(picture) for picture in pictures],
    }


def prepare(plan, rig, threads):
    """The camera, and Cycles for quick pictures."""
    camera = new_camera(SENSOR_MM * rig.focal)
    configure(camera, {}, 0.0, [])
    quality(plan.size, plan.size, plan.samples)
    scene = bpy.context.scene
    scene.render.use_persistent_data = True  # the room stays as it is
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 3
    if threads:
        scene.render.threads_mode, scene.render.threads = "FIXED", threads


def shoot(out, plan, scene, picture, label):
    """Render one picture."""
    blender = bpy.context.scene
    blender.cycles.samples = plan.truth_samples if picture.split == "test" else plan.samples
    blender.camera.matrix_world = picture.pose.T.tolist()
    scene.pose(picture.time)
    for thing in scene.moving:
        thing.hide_render = picture.path.startswith(EMPTIED)
    render(out / picture.path, picture.time * (FRAMES - 1), label)


def start(out, pictures, scene, focal, seed):
    """Surface points of the first time, as the training cameras see them."""
    scene.pose(0.0)
    views = [
        (picture.pose, read(out / picture.path))
        for picture in pictures
        if picture.time == 0 and picture.split == "train"
    ]
    groups = [(scene.moving, POINTS)]
    if scene.fixed:
        groups = [(scene.moving, ON_MOVING), (scene.fixed, POINTS - ON_MOVING)]
    found = points.sample(groups, views, focal, np.random.default_rng(seed))
    points.write_ply(out / "points3d.ply", *found)


if __name__ == "__main__":
    main()
