"""How the cost of a frame grows, and the exponents of it.

python -m benchmarks.bench_scaling [--axes gaussians pixels samples hits devices] [--gaussians ...]

Frames of the dynamic room, made as by `bench_render --room`; each axis is varied from --base
Gaussians, --side pixels across and one ray a pixel. `samples` is rays a pixel through an aperture,
`hits` how many Gaussians a ray meets before it is spent, raised by `--spread` times larger and
fainter ones.
`devices` is the frames per second of a video: a pinhole's and, with 16 rays a pixel, depth of field
(`Renderer.render_frames`: pictures fetched, no files), and the latter as a data set
(`render_dataset`: pictures compressed and written, lists, a video for each of 8 cameras).
Exponents are least squares on logarithms.
"""

import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product

import equinox as eqx
import jax
import numpy as np
from numpy.typing import ArrayLike

from benchmarks import exact
from benchmarks.frames import Shot, filmed, true_pixels
from benchmarks.problem import cameras, dynamic_room, film_of
from benchmarks.record import backend, begin, record, show
from gaussray.camera.camera import Camera
from gaussray.dataset.manifest import FrameRecord
from gaussray.render import Renderer, RenderOptions
from gaussray.render.dataset import render_dataset
from gaussray.scene.scene import Scene
from gaussray.tracer.options import TraceOptions


AXES = ("gaussians", "pixels", "samples", "hits", "devices")
# Cameras of a data set.
CAMERAS = 8
# Which figure of a line is the axis.
ALONG = {"gaussians": "gaussians", "pixels": "rays", "samples": "samples", "hits": "hits_per_ray"}


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--axes", nargs="+", choices=AXES, default=AXES)
    parser.add_argument("--base", type=int, default=10_000, help="Gaussians on the other axes")
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("--k", type=int, default=8)
    parser.add_argument("--gaussians", type=int, nargs="+", default=[3_000, 10_000, 30_000])
    parser.add_argument("--sides", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--samples", type=int, nargs="+", default=[1, 4, 16])
    parser.add_argument("--spread", type=float, nargs="+", default=[1.0, 1.5, 2.0])
    parser.add_argument("--devices", type=int, nargs="+", default=None, help="1 to all by doubling")
    parser.add_argument("--frames", type=int, default=16, help="of the video")
    chosen = parser.parse_args(argv)
    trace = TraceOptions(k=chosen.k, backend=chosen.backend)
    rows, fits = [], []
    for axis in chosen.axes:
        if axis == "devices":
            rows += list(on_devices(chosen, trace))
            continue
        settings, effects, shots = zip(*problems(axis, chosen, trace), strict=True)
        own = []
        for setting, effect, (figures, _) in zip(
            settings, effects, filmed(shots, jobs=chosen.jobs), strict=True
        ):
            named = {"axis": axis, "setting": setting, "effect": effect, "scene": "dynamic_room"}
            own.append(record("scaling", **named, **figures))
        rows += own
        seconds = [row["run_s_median"] for row in own]
        fits.append((axis, exponent([row[ALONG[axis]] for row in own], seconds)))
    names = ("axis", "gaussians", "rays", "samples", "hits_per_ray", "devices", "backend")
    show(rows, *names, "compile_s", "run_s_median", "fps", "psnr_vs_exact", "dropped")
    for axis, power in fits:
        print(f"seconds ~ {axis}^{power:.2f}")


def problems(axis: str, chosen, trace: TraceOptions) -> Iterator[tuple[float, str, Shot]]:
    """Setting, effect and shot of the points along an axis."""

    def shot(scene: Scene, effect: str, side: int = chosen.side, samples: int = 1):
        camera = cameras(side)[effect]
        truth = partial(true_pixels, scene, camera, samples)
        return effect, Shot(scene, camera, RenderOptions(samples=samples), trace, truth)

    if axis == "gaussians":
        for count in chosen.gaussians:
            yield count, *shot(dynamic_room(count), "pinhole")
        return
    scene = dynamic_room(chosen.base)
    if axis == "pixels":
        for side in chosen.sides:
            yield side, *shot(scene, "pinhole", side)
    elif axis == "samples":
        for samples in chosen.samples:
            yield samples, *shot(scene, "depth_of_field", samples=samples)
    else:
        for times in chosen.spread:
            yield times, *shot(spread(scene, times), "pinhole")


def spread(scene: Scene, times: float) -> Scene:
    """All Gaussians so many times larger and, by the square, fainter: surfaces as dense as before,
    of more hits."""

    def where(s: Scene):
        return s.static.scale, s.static.opacity, s.moving.scale, s.moving.opacity

    scale, opacity, moving_scale, moving_opacity = where(scene)
    wide = scale * times, opacity / times**2, moving_scale * times, moving_opacity / times**2
    return eqx.tree_at(where, scene, wide)


def on_devices(chosen, trace: TraceOptions) -> Iterator[dict]:
    """Videos and a data set on 1, 2, ... devices: seconds a frame."""
    scene, there = dynamic_room(chosen.base), len(jax.local_devices())
    numbers = chosen.devices or [n for n in (1, 2, 4, 8) if n <= there]
    for effect, samples in (("pinhole", 1), ("depth_of_field", 16)):
        views = list(film_of(cameras(chosen.side)[effect], chosen.frames))
        where, truth = true_pixels(scene, views[0], samples)
        rays = chosen.side**2 * samples
        for devices, written in product(numbers, (False, True)):
            if written and effect == "pinhole":
                continue
            options = RenderOptions(samples=samples)
            renderer = Renderer(scene, options=options, trace=trace, devices=devices)
            began = time.perf_counter()
            first = list(renderer.render_frames(views))[0]
            compiling = time.perf_counter() - began
            seconds = []
            for _ in range(3):
                began = time.perf_counter()
                if written:
                    _write(scene, views, options, trace, devices)
                else:
                    hits = [frame.hits for frame in renderer.render_frames(views)]
                seconds.append((time.perf_counter() - began) / len(views))
            yield record(
                "scaling",
                axis="data_set" if written else "devices",
                setting=devices,
                effect=effect,
                scene="dynamic_room",
                gaussians=chosen.base,
                rays=rays,
                samples=samples,
                k=trace.k,
                backend=backend(trace.backend),
                direction="forward",
                compile_s=None if written else round(compiling - seconds[0] * len(views), 3),
                run_s_median=float(np.median(seconds)),
                run_s_min=min(seconds),
                **exact.errors(first.color.reshape(-1, 3)[where], truth),
                hits_per_ray=None if written else sum(hits) / len(views) / rays,
                dropped=0,
                devices=devices,
            )


def _write(scene: Scene, views: list[Camera], options, trace: TraceOptions, devices: int) -> None:
    each = -(-len(views) // CAMERAS)
    records = [
        FrameRecord(f"images/{i // each}/{i % each:04d}.png", view, f"camera_{i // each}", "test")
        for i, view in enumerate(views)
    ]
    with tempfile.TemporaryDirectory() as out:
        renderer = Renderer(scene, options=options, trace=trace, devices=devices)
        render_dataset(renderer, records, out, quiet=True)


def exponent(x: ArrayLike, seconds: ArrayLike) -> float:
    """The power p of seconds ~ x^p."""
    return float(np.polyfit(np.log(x), np.log(seconds), 1)[0]) if np.ptp(x) > 0 else np.nan


if __name__ == "__main__":
    main()
