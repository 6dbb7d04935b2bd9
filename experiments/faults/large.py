"""What a large frame takes: 4096 x 4096 pixels, 64 samples of a lens, 5,000,000 Gaussians.

`python -m experiments.faults.large`: one strip of rows from the middle of the frame, as
`render.memory` cuts it, beside room for the whole picture; `--rows 4096` is the whole frame.
"""

import argparse
import dataclasses
import resource
import time

import jax
import numpy as np

from experiments.faults.toy import records, scene_of, single
from gaussray.camera.aperture import Aperture
from gaussray.camera.film import Film
from gaussray.camera.lens import pinhole
from gaussray.parts import strip_rows
from gaussray.render import Renderer, RenderOptions
from gaussray.tracer.trace import TraceOptions


def peak() -> float:
    """Gigabytes that this process has had in memory at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=4096)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--gaussians", type=int, default=5_000_000)
    parser.add_argument("--memory", type=float, default=8.0, help="render.memory")
    parser.add_argument("--rows", type=int, default=0, help="0: those of one strip")
    chosen = parser.parse_args()
    side, trace = chosen.side, TraceOptions()
    options = RenderOptions(samples=chosen.samples, memory=chosen.memory)
    strip = strip_rows(Film(side, side, "center"), options, trace)
    rows = chosen.rows or strip
    began = time.monotonic()
    scene = scene_of(chosen.gaussians)
    size = sum(x.nbytes for x in jax.tree.leaves(scene)) / 1e9
    print(f"{chosen.gaussians} Gaussians: {size:.2f} GB, {time.monotonic() - began:.0f} s, "
          f"peak {peak():.2f} GB", flush=True)  # fmt: skip
    picture = np.zeros((side, side, 5), np.float32) + 1
    camera = dataclasses.replace(
        records()[0].camera,
        film=Film(side, rows, "center"),
        lens=pinhole(single([side, side]), single([side / 2, rows / 2])),
        aperture=Aperture(single(0.02), single(3), single(0), single(1)),
    )
    began = time.monotonic()
    frame = Renderer(scene, options=options, trace=trace, devices=1)(camera)
    picture[:rows, :, :3] = frame.color
    device = jax.local_devices()[0]
    there = (device.memory_stats() or {}).get("peak_bytes_in_use", 0) / 1e9
    print(f"{rows} of {side} rows, in strips of {min(strip, rows)} (render.memory="
          f"{chosen.memory:g}), {chosen.samples} samples, {device.device_kind}: "
          f"{time.monotonic() - began:.0f} s with compilation, {frame.hits / 1e6:.0f} M hits; "
          f"peak {peak():.2f} GB of the host, {there:.2f} GB of the device")  # fmt: skip


if __name__ == "__main__":
    main()
