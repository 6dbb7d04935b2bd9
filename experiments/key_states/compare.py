"""Key states and row chunks against deforming at every row, on a trained scene.

python experiments/key_states/compare.py SCENE
"""

import os
import sys

import jax
import numpy as np


def main(folder: str) -> None:
    """Print PSNR in linear light against one state per row, and seconds a frame, for each way."""
    jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))

    from gaussray.capture.formats.paired import read_capture
    from gaussray.io.sample_data import sample
    from gaussray.render import Renderer, RenderOptions
    from gaussray.scene.store import load_scene

    scene = load_scene(folder)
    views = read_capture(sample("capture")).effects["rolling_shutter"][1::3]
    exact = Renderer(scene, options=RenderOptions(samples=1, chunk_rows=1))
    truth = [exact(view.camera) for view in views]
    print(f"{'way':<16}{'PSNR mean':>12}{'PSNR worst':>12}{'s a frame':>12}")
    print(f"{'1 row a chunk':<16}{'-':>12}{'-':>12}{np.median([f.seconds for f in truth]):>12.3f}")
    ways = {f"{keys} keys": RenderOptions(samples=1, keys=keys) for keys in (2, 3, 5, 9, 17)}
    ways |= {
        f"{rows} rows a chunk": RenderOptions(samples=1, chunk_rows=rows) for rows in (4, 16, 128)
    }
    for name, options in ways.items():
        render = Renderer(scene, options=options)
        frames = [render(view.camera) for view in views]
        error = [np.mean((a.color - b.color) ** 2) for a, b in zip(truth, frames, strict=True)]
        decibel = -10 * np.log10(np.maximum(error, 1e-12))
        seconds = np.median([render(view.camera).seconds for view in views])
        print(f"{name:<16}{decibel.mean():>12.2f}{decibel.min():>12.2f}{seconds:>12.3f}")


if __name__ == "__main__":
    main(sys.argv[1])
