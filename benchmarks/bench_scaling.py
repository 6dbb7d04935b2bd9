"""How the cost of a frame grows, and the exponents of it.

python -m benchmarks.bench_scaling [--axes gaussians pixels samples hits devices] [--gaussians ...]

Frames of the dynamic room, made as by `bench_render --room`; each axis is varied from --base
Gaussians, --side pixels across and one ray a pixel. `samples` is rays a pixel through an aperture,
`hits` how many Gaussians a ray meets before it is spent, raised by `--spread` times larger and
fainter ones.
`devices` is the frames per second of a video (`Renderer.film`: pictures fetched, no files).
Exponents are least squares on logarithms.
"""

import time
from collections.abc import Iterator, Sequence
from functools import partial

import equinox as eqx
import jax
import numpy as np
from numpy.typing import ArrayLike

from benchmarks import exact
from benchmarks.frames import Shot, filmed, true_pixels
from benchmarks.problem import cameras, dynamic_room, film_of
from benchmarks.record import backend, begin, record, show
from gaussray.render import Renderer, RenderOptions
from gaussray.scene.scene import Scene
from gaussray.tracer.trace import TraceOptions


AXES = ("gaussians", "pixels", "samples", "hits", "devices")
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
    """A video on 1, 2, ... devices: seconds a frame, pictures fetched."""
    scene, camera = dynamic_room(chosen.base), cameras(chosen.side)["pinhole"]
    there = len(jax.local_devices())
    views = list(film_of(camera, chosen.frames))
    where, truth = true_pixels(scene, views[0], 1)
    for devices in chosen.devices or [n for n in (1, 2, 4, 8) if n <= there]:
        renderer = Renderer(scene, options=RenderOptions(samples=1), trace=trace, devices=devices)
        began = time.perf_counter()
        first = next(iter(list(renderer.film(views))))
        compiling = time.perf_counter() - began
        seconds = []
        for _ in range(3):
            began = time.perf_counter()
            hits = sum(frame.hits for frame in renderer.film(views))
            seconds.append((time.perf_counter() - began) / len(views))
        yield record(
            "scaling",
            axis="devices",
            setting=devices,
            effect="pinhole",
            scene="dynamic_room",
            gaussians=chosen.base,
            rays=chosen.side**2,
            samples=1,
            k=trace.k,
            backend=backend(trace.backend),
            direction="forward",
            compile_s=round(compiling - seconds[0] * len(views), 3),
            run_s_median=float(np.median(seconds)),
            run_s_min=min(seconds),
            **exact.errors(first.color.reshape(-1, 3)[where], truth),
            hits_per_ray=hits / len(views) / chosen.side**2,
            dropped=0,
            devices=devices,
        )


def exponent(x: ArrayLike, seconds: ArrayLike) -> float:
    """The power p of seconds ~ x^p."""
    return float(np.polyfit(np.log(x), np.log(seconds), 1)[0]) if np.ptp(x) > 0 else np.nan


if __name__ == "__main__":
    main()
