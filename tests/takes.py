"""What `test_factory.py` kills: `takes.py SCENE OUT N` films six takes of two frames, and is gone
when its file number N (0: none) is written but not yet in its place."""

import os
import signal
import sys

import jax

from gaussray.cli import main


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


if __name__ == "__main__":
    scene, out, number = sys.argv[1:]
    jax.config.update("jax_disable_most_optimizations", True)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    mortal(int(number))
    main(
        [
            *("render", f"scene={scene}", f"out={out}", "factory.count=6", "quiet=true"),
            *("format=exr", "camera.times=[0.0,0.5]", "render.samples=1", "devices.count=1"),
            *("trace.levels=0", "trace.group=2", "trace.chunk=8"),
            *("lens=equidistant", "sample.lens.fov.uniform=[60,120]"),
            *("sample.camera.names.choice=[[cam_0],[cam_1]]", "sensor.read_noise=1"),
            *("sensor.full_well=1000", "sample.sensor.exposure.normal=[0,1]"),
        ]
    )
