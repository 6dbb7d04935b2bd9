"""Render the sample capture: thrown objects in a room, seen by pinhole and by real cameras.

    python -m experiments.quickstart.render_capture --out DIR
    python -m experiments.quickstart.render_capture --out DIR --check

Needs nothing but Blender as a Python module, `bpy` 4.5, and its numpy. If stopped, it resumes.
"""

import argparse
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.blender import effects, physics, points
from experiments.blender.checks import report, verify, write_json
from experiments.blender.session import quality, read, render
from experiments.quickstart import cameras, room


FPS = 20
MARGIN = 2  # frames simulated before the first and after the last
TOTAL, PER_BODY = 12000, 700  # starting points, and those on each moving object
KIND = {"train": "jpg", "test": "png"}  # what is scored stays lossless


class Image(NamedTuple):
    """One image to render, and what its JSON file says of it."""

    path: str
    blocks: dict
    frame: int
    camera: str
    split: str
    pose: np.ndarray


def main():
    args = arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    images, files = plan(args)
    if not args.check:
        for name, content in files.items():
            write_json(args.out / name, content)
        render_all(args, images)
    verify(args.out)
    report(args.out)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the capture")
    parser.add_argument("--size", type=int, default=128, help="width and height in pixels")
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--cameras", type=int, default=16, help="3 in 16 are held out")
    parser.add_argument("--samples", type=int, default=32, help="per pixel, before denoising")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--check", action="store_true", help="only verify and measure what is there"
    )
    args = parser.parse_args()
    if args.frames < 8 or args.cameras < 4:
        parser.error("--frames must be at least 8 and --cameras at least 4.")
    return args


def plan(args):
    """Every image of the capture and the JSON files that list them."""
    rig = cameras.rig(args.cameras, args.seed)
    common = {
        **cameras.intrinsics(args.size),
        "camera_model": "PINHOLE",
        "time_unit": "normalised",
        "color_space": "srgb",
    }
    pinhole = [
        Image(f"images/{name}/{frame:04d}.{KIND[split]}", {}, frame, name, split, pose)
        for name, split, pose in rig
        for frame in range(args.frames)
    ]
    images = list(pinhole)
    files = {
        "transforms.json": {
            **common,
            "ply_file_path": "points3d.ply",
            "frames": [listed(image, args.frames) for image in pinhole],
        }
    }
    for effect, (blocks, frames) in cameras.effects(args.size, args.frames).items():
        made = [
            Image(f"{effect}/{name}/{frame:04d}.png", blocks, frame, name, split, pose)
            for name, split, pose in rig
            if split == "test"
            for frame in frames
        ]
        images += made
        files[f"{effect}.json"] = {
            **common,
            "effect": effect,
            **blocks,
            "samples": args.samples,
            "frames": [listed(image, args.frames) for image in made],
        }
    return images, files


def listed(image, frames):
    return {
        "file_path": image.path,
        "transform_matrix": image.pose.round(9).tolist(),
        "time": image.frame / (frames - 1),
        "camera": image.camera,
        "split": image.split,
    }


def render_all(args, images):
    fixed, moving = room.build()
    thrown = [room.thrown(*pair) for pair in zip(moving, room.BODIES, strict=True)]
    physics.bake(fixed, thrown, args.frames, fps=FPS, margin=MARGIN)
    camera = effects.new_camera(cameras.LENS_MM)
    quality(args.size, args.size, args.samples)
    missing = [image for image in images if not (args.out / image.path).exists()]
    started = time.monotonic()
    for done, image in enumerate(missing):
        effects.configure(camera, image.blocks, cameras.READOUT, moving)
        camera.matrix_world = image.pose.T.tolist()
        render(args.out / image.path, image.frame, f"{args.seed} {image.path}")
        passed = time.monotonic() - started
        left = passed / (done + 1) * (len(missing) - done - 1)
        progress = f"{done + 1}/{len(missing)} {image.path}"
        print(f"{progress}  {passed:.0f} s, {left:.0f} s left", flush=True)
    start = args.out / "points3d.ply"
    if not start.exists():
        views = [
            (image.pose, read(args.out / image.path))
            for image in images
            if not image.blocks and image.frame == 0 and image.split == "train"
        ]
        focal = cameras.intrinsics(args.size)["fl_x"]
        rng = np.random.default_rng(args.seed)
        groups = [([thing], PER_BODY) for thing in moving]
        groups.append((fixed, TOTAL - PER_BODY * len(moving)))
        points.write_ply(start, *points.sample(groups, views, focal, rng))


if __name__ == "__main__":
    main()
