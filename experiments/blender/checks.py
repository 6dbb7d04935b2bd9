"""A capture that is whole, and how still it is."""

import json
import os
import sys

import numpy as np

from experiments.blender.session import read


MOVING = 0.1  # a pixel moves if a channel is this far from its camera's temporal median


def write_json(path, content):
    """Write once, whole or not at all, for other shards read it; a folder that holds another
    capture is refused, so that no two are mixed."""
    text = json.dumps(content, indent=1) + "\n"
    if path.exists() and path.read_text() != text:
        sys.exit(f"{path} was written with other settings. Choose another --out, or remove it.")
    partial = path.with_suffix(f".part{os.getpid()}")
    partial.write_text(text)
    os.replace(partial, path)


def verify(out):
    """Every listed file is there, and nothing half-written."""
    listed_paths = []
    for file in sorted(out.glob("*.json")):
        content = json.loads(file.read_text())
        listed_paths += [content["ply_file_path"]] if "ply_file_path" in content else []
        listed_paths += [frame["file_path"] for frame in content["frames"]]
    absent = [path for path in listed_paths if not (out / path).is_file()]
    if absent:
        sys.exit(
            f"{len(absent)} of {len(listed_paths)} files are missing, first {out / absent[0]}."
        )
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    print(f"{len(listed_paths)} files present, {size / 1e6:.2f} MB in all")


def report(out):
    """How well a still picture, the temporal median of each camera, explains the frames: cameras
    that are learnt from, and those held out."""
    frames = json.loads((out / "transforms.json").read_text())["frames"]
    learnt = {frame["camera"] for frame in frames if frame["split"] == "train"}
    views = {}
    for frame in frames:
        videos = views.setdefault("train" if frame["camera"] in learnt else "test", {})
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
