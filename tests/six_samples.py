"""What `test_generate.py` kills: `six_samples.py SCENE OUT N CAMERA` renders samples of two frames.
The process is killed when file number N (0: none) is written but not yet in its place.

With CAMERA = quick all is as ever but the pictures, which show noise instead of the scene.
"""

import os
import signal
import sys

import jax
import numpy as np

from gaussray.cli.main import main
from gaussray.render.frame import DevelopedFrame
from gaussray.render.renderer import Renderer


def mortal(at: int) -> None:
    """Let this process be killed."""
    replace, files = os.replace, 0

    def move(source, target):
        nonlocal files
        files += 1
        if files == at:
            os.kill(os.getpid(), signal.SIGKILL)
        replace(source, target)

    os.replace = move


def quick(_, cameras, develop):
    """Frames that no one has to wait for (`Renderer.render_developed`)."""
    for number, camera in enumerate(cameras):
        chance = np.random.default_rng(int.from_bytes(np.asarray(camera.lens.focal).tobytes()))
        light = chance.random((camera.film.height, camera.film.width, 3), np.float32)
        yield DevelopedFrame(jax.device_get(develop(number, jax.numpy.asarray(light))), samples=1)


if __name__ == "__main__":
    scene, out, number, camera = sys.argv[1:]
    if camera == "quick":
        Renderer.render_developed = quick
    jax.config.update("jax_disable_most_optimizations", True)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    mortal(int(number))
    main(
        [
            *("render", f"scene={scene}", f"out={out}", "dataset.count=6", "quiet=true"),
            *("format=exr", "camera.times=[0.0,0.5]", "render.samples=1", "devices.count=1"),
            *("trace.levels=0", "trace.group=2", "trace.chunk=8"),
            *("trace.k=4", "lens=pinhole", "sample.lens.fov.uniform=[60,120]"),
            *("sample.camera.names.choice=[[cam_0],[cam_1]]", "dataset.frames=0"),
        ]
    )
