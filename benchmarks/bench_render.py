"""Frames per second of a trained scene, effect by effect, at the sample's held-out cameras.

python benchmarks/bench_render.py SCENE [--frames 6]

`psnr_vs_exact` and `max_error` compare with k = 32, transmittance to the end and, for the rolling
shutter, one state of the scene per row.
"""

import argparse
import sys
from pathlib import Path

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene")
    parser.add_argument("--frames", type=int, default=6)
    chosen = parser.parse_args()
    from benchmarks.problem import record, show, use_all_cores
    from gaussray.capture.calibration import read_capture
    from gaussray.demo import SAMPLE
    from gaussray.render import Renderer, RenderOptions
    from gaussray.scene.store import load_scene
    from gaussray.tracer.trace import TraceOptions

    use_all_cores()
    scene, capture = load_scene(chosen.scene), read_capture(SAMPLE)
    views = {"pinhole": [v for v in capture.views if v.split == "test"], **capture.effects}
    count = {"pinhole": 1, "rolling_shutter": 1, "fisheye": 4, "depth_of_field": 16}
    rows = []
    for effect, own in views.items():
        samples = count.get(effect, 16)
        own = own[:: max(len(own) // chosen.frames, 1)][: chosen.frames]
        exact = Renderer(
            scene,
            options=RenderOptions(samples=samples, chunk_rows=1),
            trace=TraceOptions(k=32, transmittance_min=0.0),
        )
        truth = exact(own[0].camera).color
        for k in (4, 8, 16):
            renderer = Renderer(
                scene, options=RenderOptions(samples=samples), trace=TraceOptions(k=k)
            )
            first = renderer(own[0].camera)
            seconds = [renderer(view.camera).seconds for view in own for _ in range(2)]
            error = np.abs(first.color - truth)
            film = own[0].camera.film
            rays = film.width * film.height * samples
            rows.append(
                record(
                    "render",
                    effect=effect,
                    scene=str(chosen.scene),
                    gaussians=scene.static.count + scene.moving.count,
                    rays=rays,
                    k=k,
                    backend="array",
                    direction="forward",
                    compile_s=round(first.seconds - min(seconds), 2),
                    run_s_median=float(np.median(seconds)),
                    run_s_min=float(min(seconds)),
                    fps=1 / float(np.median(seconds)),
                    rays_per_s=rays / float(np.median(seconds)),
                    psnr_vs_exact=float(-10 * np.log10(max(np.mean(error**2), 1e-12))),
                    max_error=float(error.max()),
                    dropped=0,
                )
            )
    show(rows, ("effect", "k", "run_s_median", "fps", "psnr_vs_exact", "max_error", "dropped"))


if __name__ == "__main__":
    main()
