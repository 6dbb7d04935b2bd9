"""How well an effect's pictures come out where training cameras looked, and where none did.

    python -m experiments.reconstruction.unseen SCENE CAPTURE [--effects NAME ...] [--frames 8]

A pixel counts as looked at by a training camera if the surface that it shows at the middle of its
exposure (the scene's own depth) falls into that camera's picture; what stands before it is not
asked, so the counts are upper bounds. Scores are pooled over all pixels of a count.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.rolling_projection import pixel_at
from gaussray.capture.frames import read_encoded
from gaussray.capture.open import open_capture
from gaussray.dataset.images import srgb_levels
from gaussray.render import Renderer, RenderOptions
from gaussray.render.aov.labeller import Labeller
from gaussray.scene.scene import Scene
from gaussray.scene.store import load_scene
from gaussray.tracer.options import TraceOptions


BINS = ((0, 0), (1, 1), (2, 3), (4, 7), (8, 10**6))


def lookers(cameras, points):
    """How many of the cameras have each point [n, 3] in their picture."""
    count = np.zeros(len(points), int)
    for camera in cameras:
        place = np.asarray(jax.vmap(lambda p, c=camera: pixel_at(c, p, c.time))(points))
        with np.errstate(invalid="ignore"):
            size = camera.film.width, camera.film.height
            count += np.all((place >= 0) & (place <= size), axis=1)
    return count


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--effects", nargs="+", default=["pinhole", "fisheye"])
    parser.add_argument("--frames", type=int, default=8, help="of each effect, evenly spread")
    chosen = parser.parse_args()
    scene, capture = load_scene(chosen.scene), open_capture(chosen.capture)
    assert isinstance(scene, Scene)
    learnt = {v.camera_name: v.camera for v in reversed(capture.views) if v.split == "train"}
    groups = {"pinhole": capture.views, **capture.effects}
    print("| effect | training cameras that look there | share of pixels | PSNR |")
    print("|---" * 4 + "|")
    for effect in chosen.effects:
        views = [v for v in groups[effect] if v.camera_name not in learnt]
        place = np.linspace(0, len(views) - 1, chosen.frames).round().astype(int)
        options = RenderOptions(samples=1 if effect == "pinhole" else 4)
        renderer = Renderer(scene, options=options, trace=TraceOptions())
        labeller = Labeller(scene, options=options, trace=TraceOptions())
        errors, counts = [], []
        for i in sorted(set(place.tolist())):
            camera = views[i].camera
            ours = srgb_levels(renderer(camera).color).astype(np.float64)
            error = ((ours - read_encoded(views[i])) / 255) ** 2
            seen = labeller(camera, ("depth", "origin", "direction", "valid"))
            point = seen["origin"] + seen["depth"][..., None] * seen["direction"]
            flat = jnp.asarray(np.nan_to_num(point.reshape(-1, 3)))
            count = lookers(list(learnt.values()), flat)
            kept = (seen["valid"] > 0).reshape(-1)
            errors.append(error.reshape(-1, 3)[kept].mean(axis=1))
            counts.append(count[kept])
        error, count = np.concatenate(errors), np.concatenate(counts)
        for low, high in BINS:
            mine = (count >= low) & (count <= high)
            label = f"{low}" if low == high else f"{low} to {high}" if high < 10**6 else f"{low}+"
            score = -10 * np.log10(error[mine].mean()) if mine.any() else float("nan")
            print(f"| {effect} | {label} | {mine.mean():.3f} | {score:.2f} |")
        print(f"| {effect} | all | 1 | {-10 * np.log10(error.mean()):.2f} |", flush=True)


if __name__ == "__main__":
    main()
