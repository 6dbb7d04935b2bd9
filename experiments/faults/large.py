"""What a large frame takes: 4096 x 4096 pixels, 64 samples of a lens, 5,000,000 Gaussians.

`python -m experiments.faults.large`: one strip of rows from the middle of the frame, as
`render.memory` cuts it, beside room for the whole picture; `--rows 4096` is the whole frame,
`--count` compiles the strip and asks XLA what it would take. `--frames 300` films a long sequence
of small frames instead, and tells the memory on the way.
"""

import argparse
import dataclasses
import os
import resource
import time

import jax
import numpy as np

from experiments.faults.toy import records, scene_of, single
from gaussray.camera.aperture import Aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import pinhole
from gaussray.render import Renderer, RenderOptions
from gaussray.render.compiled import ProgramSettings, render_part
from gaussray.render.frame_batch import FrameBatch
from gaussray.render.parts import strip_plan
from gaussray.runtime.jit_cache import compiled
from gaussray.scene.scene import Scene
from gaussray.tracer.options import TraceOptions


def peak() -> float:
    """Gigabytes that this process has had in memory at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def held() -> float:
    """Gigabytes that this process has in memory."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9


def camera_of(side: int, rows: int) -> Camera:
    """So many rows of the middle of a square frame, through a lens that is open."""
    return dataclasses.replace(
        records()[0].camera,
        film=Film(side, rows, "center"),
        lens=pinhole(single([side, side]), single([side / 2, rows / 2])),
        aperture=Aperture(single(0.02), single(3), single(0), single(1)),
    )


def count(renderer: Renderer, camera: Camera) -> float:
    """Gigabytes that XLA asks for to render a part, beside what it is given."""
    (view,) = renderer._views.views([camera])
    film = camera.film
    count = sum(scene.count for scene in renderer.scenes)
    rows, trace = strip_plan(film, renderer.options, renderer.trace, count)
    batch = FrameBatch([view], True, rows, trace, view.layout)
    part, trace, _ = renderer._part(0, batch)
    capacity = renderer._measure(batch, part, trace)
    settings = ProgramSettings(capacity, view.keys, renderer.options, trace, renderer.mesh)
    leaves, structure = renderer._flat[0]
    program = render_part(structure, view.layout, settings).lower(leaves, view.row, part).compile()
    found = program.memory_analysis()
    print(f"{rows} rows in bundles of {trace.levels} levels, {capacity.pairs} pairs in lists")
    return found.temp_size_in_bytes / 1e9


def strip(scene: Scene, chosen: argparse.Namespace) -> None:
    """A strip of the frame, and what the frame would take."""
    side, trace = chosen.side, TraceOptions()
    options = RenderOptions(samples=chosen.samples, memory=chosen.memory)
    rows = (
        chosen.rows or strip_plan(Film(side, side, "center"), options, trace, chosen.gaussians)[0]
    )
    renderer = Renderer(scene, options=options, trace=trace, devices=1)
    if chosen.count:
        asked = count(renderer, camera_of(side, rows))
        print(f"XLA asks for {asked:.2f} GB; measuring: peak {peak():.2f} GB of the host")
        return
    picture, began = np.ones((side, side, 5), np.float32), time.monotonic()
    frame = renderer(camera_of(side, rows))
    picture[:rows, :, :3] = frame.color
    seconds, device = time.monotonic() - began, jax.local_devices()[0]
    work = seconds - compiled()
    there = (device.memory_stats() or {}).get("peak_bytes_in_use", 0) / 1e9
    print(f"{rows} of {side} rows (render.memory={chosen.memory:g}), {chosen.samples} samples, "
          f"{device.device_kind}: {seconds:.0f} s, {work:.0f} s of them without compilation; "
          f"{frame.hits / 1e6:.0f} M hits; peak {peak():.2f} GB of the host, {there:.2f} GB of the "
          f"device. {side / rows:g} such strips: {work * side / rows / 3600:.1f} h")  # fmt: skip


def sequence(chosen: argparse.Namespace) -> None:
    """Frame after frame, and the memory that the process has by then."""
    options = RenderOptions(samples=chosen.samples)
    renderer = Renderer(scene_of(chosen.gaussians), options=options, devices=1)
    still = camera_of(chosen.side, chosen.side)
    cameras = (
        dataclasses.replace(still, time=single(i / chosen.frames)) for i in range(chosen.frames)
    )
    for done, _ in enumerate(renderer.render_frames(cameras), 1):
        if done in (1, 10) or done % (chosen.frames // 3) == 0:
            print(f"{done} frames: {held():.3f} GB, peak {peak():.3f} GB", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=4096)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--gaussians", type=int, default=5_000_000)
    parser.add_argument("--memory", type=float, default=8.0, help="render.memory")
    parser.add_argument("--rows", type=int, default=0, help="0: those of one strip")
    parser.add_argument("--count", action="store_true", help="ask XLA, render nothing")
    parser.add_argument("--frames", type=int, default=0, help="a sequence of so many frames")
    chosen = parser.parse_args()
    compiled()
    if chosen.frames:
        sequence(chosen)
        return
    began = time.monotonic()
    scene = scene_of(chosen.gaussians)
    size = sum(x.nbytes for x in jax.tree.leaves(scene)) / 1e9
    print(f"{chosen.gaussians} Gaussians: {size:.2f} GB, {time.monotonic() - began:.0f} s, "
          f"peak {peak():.2f} GB", flush=True)  # fmt: skip
    strip(scene, chosen)


if __name__ == "__main__":
    main()
