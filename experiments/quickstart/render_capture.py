"""Render the sample capture: thrown objects in a room, seen by pinhole and by real cameras.

    python experiments/quickstart/render_capture.py --out DIR
    python experiments/quickstart/render_capture.py --out DIR --check

Needs nothing but Blender as a Python module, `bpy` 4.5, and its numpy. If stopped, it resumes.
"""

import argparse
import contextlib
import json
import os
import sys
import time
import zlib
from pathlib import Path
from typing import NamedTuple

import bpy
import cameras
import motion
import numpy as np
import points
import room


# The wheel of bpy carries OpenImageIO in a folder of its own.
for folder in Path(bpy.utils.resource_path("LOCAL")).glob("python/lib/python3*/site-packages"):
    sys.path.append(str(folder))
import OpenImageIO as oiio  # noqa: E402


KIND = {"train": "jpg", "test": "png"}  # what is scored stays lossless
MOVING = 0.1  # a pixel moves if a channel is this far from its camera's temporal median


class Image(NamedTuple):
    """One image to render, and what its JSON file says of it."""

    path: str
    effect: str | None
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
        Image(f"images/{name}/{frame:04d}.{KIND[split]}", None, frame, name, split, pose)
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
            Image(f"{effect}/{name}/{frame:04d}.png", effect, frame, name, split, pose)
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


def write_json(path, content):
    """Write once; a folder that holds another capture is refused, so that no two are mixed."""
    text = json.dumps(content, indent=1) + "\n"
    if path.exists() and path.read_text() != text:
        sys.exit(f"{path} was written with other settings. Choose another --out, or remove it.")
    path.write_text(text)


def render_all(args, images):
    fixed, moving = room.build()
    motion.bake(fixed, moving, room.BODIES, args.frames)
    camera = cameras.new_camera()
    quality(args)
    missing = [image for image in images if not (args.out / image.path).exists()]
    started = time.monotonic()
    for done, image in enumerate(missing):
        render(args, image, camera, moving)
        passed = time.monotonic() - started
        left = passed / (done + 1) * (len(missing) - done - 1)
        progress = f"{done + 1}/{len(missing)} {image.path}"
        print(f"{progress}  {passed:.0f} s, {left:.0f} s left", flush=True)
    start = args.out / "points3d.ply"
    if not start.exists():
        views = [
            (image.pose, read(args.out / image.path))
            for image in images
            if image.effect is None and image.frame == 0 and image.split == "train"
        ]
        focal = cameras.intrinsics(args.size)["fl_x"]
        rng = np.random.default_rng(args.seed)
        points.write_ply(start, *points.sample(fixed, moving, views, focal, rng))


def quality(args):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = args.size
    scene.render.resolution_percentage = 100
    scene.render.use_persistent_data = False  # else Cycles ignores a change of motion_steps
    scene.render.dither_intensity = 0.0
    scene.render.use_file_extension = False
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.compression = 100
    for stamp in [key for key in dir(scene.render) if key.startswith("use_stamp")]:
        setattr(scene.render, stamp, False)  # no dates or paths in the files
    scene.view_settings.view_transform = "Standard"
    scene.cycles.device = "CPU"
    scene.cycles.samples = args.samples
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_light_tree = False
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 4
    scene.cycles.use_denoising = True
    scene.cycles.denoiser = "OPENIMAGEDENOISE"


def render(args, image, camera, moving):
    """Render to a temporary name, so that a file which exists is complete."""
    scene = bpy.context.scene
    cameras.configure(scene, camera, image.effect, moving)
    camera.matrix_world = image.pose.T.tolist()
    scene.cycles.seed = zlib.crc32(f"{args.seed} {image.path}".encode()) >> 1
    scene.frame_set(image.frame)
    path = args.out / image.path
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    scene.render.filepath = str(partial.resolve())
    with silence():
        bpy.ops.render.render(write_still=True)
    store(partial, path.suffix)
    partial.replace(path)


def store(path, suffix):
    """Rewrite Blender's PNG in place: no render times in it, and JPEG with full chroma."""
    array = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)
    height, width, channels = array.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.UINT8)
    if suffix == ".jpg":
        spec.attribute("Compression", "jpeg:95")
        spec.attribute("jpeg:subsampling", "4:4:4")
    else:
        spec.attribute("png:compressionLevel", 9)
    made = oiio.ImageBuf(spec)
    made.set_pixels(oiio.ROI(0, width, 0, height, 0, 1, 0, channels), array)
    if not made.write(str(path), oiio.UINT8, "jpeg" if suffix == ".jpg" else "png"):
        raise OSError(f"{path}: {made.geterror()}")


@contextlib.contextmanager
def silence():
    """Keep Blender's own lines off the screen."""
    sys.stdout.flush()
    screen = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(screen, 1)
        os.close(screen)


def read(path):
    """sRGB values in 0..1, top row first."""
    image = bpy.data.images.load(str(path.resolve()))
    width, height = image.size
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    pixels = flat.reshape(height, width, image.channels)[::-1, :, :3].copy()
    bpy.data.images.remove(image)
    return pixels


def verify(out):
    """Every listed file is there, and nothing half-written."""
    listed_paths = ["points3d.ply"]
    for file in sorted(out.glob("*.json")):
        listed_paths += [frame["file_path"] for frame in json.loads(file.read_text())["frames"]]
    absent = [path for path in listed_paths if not (out / path).is_file()]
    if absent:
        sys.exit(
            f"{len(absent)} of {len(listed_paths)} files are missing, first {out / absent[0]}."
        )
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    print(f"{len(listed_paths)} files present, {size / 1e6:.2f} MB in all")


def report(out):
    """How well a still picture, the temporal median of each camera, explains the frames."""
    views = {}
    for frame in json.loads((out / "transforms.json").read_text())["frames"]:
        videos = views.setdefault(frame["split"], {})
        videos.setdefault(frame["camera"], []).append(read(out / frame["file_path"]))
    print("temporal median against the frames, PSNR in dB:")
    for split, videos in views.items():
        whole, squared, share = zip(*map(still, videos.values()), strict=True)
        print(
            f"  {split:5s} whole image {np.mean(whole):.2f}, "
            f"moving pixels {psnr(np.concatenate(squared)):.2f} ({np.mean(share):.1%} of the image)"
        )


def still(frames):
    """Mean PSNR of the median picture, squared errors of the moving pixels, and their share."""
    frames = np.stack(frames)
    error = frames - np.median(frames, axis=0)
    moves = np.abs(error).max(axis=-1) > MOVING
    return np.mean([psnr(e**2) for e in error]), (error[moves] ** 2).ravel(), moves.mean()


def psnr(squared):
    return -10 * np.log10(np.mean(squared))


if __name__ == "__main__":
    main()
