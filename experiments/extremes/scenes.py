"""Scenes at the edge against double precision: held or failed, with the figure and its limit.

python -m experiments.extremes.scenes [--gaussians 10000000] [--side 512] [--only NAME]
"""

import experiments.extremes.alone  # noqa: F401, I001  (first: it stands in for what is missing)

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import exact
from benchmarks.problem import cameras, dynamic_room
from experiments.extremes import edge
from experiments.extremes.outcome import COLOR, DRAWS, GRADIENT, Outcome, nudged
from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.lens import Fisheye
from gaussray.camera.rays import Rays
from gaussray.render import Renderer, RenderOptions
from gaussray.scene.scene import at
from gaussray.tracer.grid import build_grid
from gaussray.tracer.motion import Motion, still
from gaussray.tracer.trace import on_kernel, trace
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.measure import measure


traced = eqx.filter_jit(trace)


def look(motion: Motion, rays: Rays, **options):
    """Pixels and report of rays, with lists as long as they need."""
    told = TraceOptions(**options)
    capacity = measure(motion, rays, options=told)
    return traced(motion, rays, options=told, capacity=capacity)


def against_exact(case: str, motion: Motion, rays: Rays, checked: int) -> Iterator[Outcome]:
    """Colour of some rays; where the inputs' own rounding moves it by more than COLOR, that is the
    limit (the largest of DRAWS): float32 cannot know better."""
    pixels, report = look(motion, rays)
    chosen = np.random.default_rng(0).choice(rays.time.shape[0], checked, replace=False)
    some = jax.tree.map(lambda x: x[chosen], rays)
    truth = exact.color(motion, some)
    error = np.mean(np.abs(np.asarray(pixels.color, np.float64)[chosen] - truth))
    limit = COLOR
    if error > limit:
        for seed in range(DRAWS):
            moved = exact.color(*nudged((motion, some), seed))
            limit = max(limit, np.mean(np.abs(moved - truth)))
    yield Outcome(f"{case}, light {truth.mean():.2f}", "colour", float(error), float(limit))
    yield Outcome(case, "lost", float(report.dropped + report.skipped), 0)


def common(told) -> Iterator[Outcome]:
    """The scenes of tests/tracer/extremes.py: values and gradients."""
    sys.path += [str(Path(__file__).parents[2] / "tests" / part) for part in ("", "tracer")]
    import extremes
    import reference
    import scenes as shared

    for name in extremes.SCENES:
        gaussians, lines = extremes.scene(name)
        motion, rays = shared.resting(gaussians), shared.shot(lines)
        weight = shared.weights(dtype=np.float32)
        pixels, report, slope = shared.pull(motion, rays, weight)
        with jax.enable_x64(True):
            heavy, some = jnp.asarray(weight, np.float64), [(motion, rays)]
            some += [nudged((motion, rays), seed) for seed in range(DRAWS)]
            some = [shared.cast(x, np.float64) for x in some]
            image, *others = (shared.stacked(reference.trace(*x)) for x in some)
            truth, *aside = (shared.natural(shared.pull_dense(*x, heavy), some[0][0]) for x in some)
            errors = shared.relative_errors(shared.natural(slope, motion), truth)
            changes = [shared.relative_errors(x, truth) for x in aside]
            inputs = {key: max(change[key] for change in changes) for key in errors}
        error = np.mean(np.abs(shared.stacked(pixels) - image)[:, :3])
        limit = max(np.mean(np.abs(other - image)[:, :3]) for other in others)
        yield Outcome(name, "colour", float(error), max(COLOR, float(limit)))
        worst = max(errors, key=lambda key: errors[key] / max(GRADIENT, inputs[key]))
        limit = max(GRADIENT, inputs[worst])
        yield Outcome(name, f"gradient ({worst})", errors[worst], limit)
        yield Outcome(name, "lost", float(report.dropped + report.skipped), 0)


def sizes(told) -> Iterator[Outcome]:
    """Very many Gaussians, and very different sizes and distances."""
    cases = {
        f"{told.gaussians} Gaussians": edge.many,
        "millimetres in kilometres": edge.millimetres_in_kilometres,
        "a galaxy from 1e6 away": lambda n, side: edge.galaxy(n, side, away=True),
        "in a galaxy at 1e6": lambda n, side: edge.galaxy(n, side, away=False),
    }
    for name, make in cases.items():
        if told.only in name:
            # More in the same heap would be as many on every ray.
            count = told.gaussians if make is edge.many else min(told.gaussians, 50000)
            shown, rays = make(count, told.side)
            yield from against_exact(name, still(shown), rays, told.checked)


def dark(told) -> Iterator[Outcome]:
    """What light is left behind sixteen layers: 1e-30."""
    shown, rays = edge.layers(0, told.side)
    pixels, _ = look(still(shown), rays, transmittance_min=0.0)
    with jax.enable_x64(True):
        double = jax.tree.map(lambda x: np.asarray(x, np.float64), (still(shown), rays))
        few = jax.tree.map(lambda x: jnp.asarray(x[:64]), double[1])
        motion = jax.tree.map(jnp.asarray, double[0])
        left = np.asarray(jax.jit(exact.reference.dense)(motion, few)[1])
    error = np.max(np.abs(np.asarray(pixels.transmittance, np.float64)[:64] / left - 1))
    yield Outcome(f"layers that leave {left.min():.0e}", "transmittance, relative", error, 1e-4)


def ties(told) -> Iterator[Outcome]:
    """Equal distances: the same bits again, and the order that `trace` promises."""
    shown, rays = edge.coplanar(0, told.side)
    first, again = (look(still(shown), rays)[0].color for _ in range(2))
    yield Outcome("coplanar", "difference to itself", float(jnp.max(abs(first - again))), 0)
    short = look(still(shown), rays, k=4)[0].color
    yield Outcome("coplanar", "k = 4 and 16", float(jnp.mean(abs(first - short))), COLOR)
    order = np.arange(shown.count)
    if not on_kernel(TraceOptions(), jnp.float32):
        index = np.asarray(build_grid(still(shown), alpha_min=TraceOptions().alpha_min).index)
        order = index[index >= 0]
    sorted_ = still(jax.tree.map(lambda x: x[order], shown))
    truth = exact.color(sorted_, jax.tree.map(lambda x: x[:256], rays))
    error = np.mean(np.abs(np.asarray(first)[:256] - truth))
    yield Outcome("coplanar", "to the order that is promised", float(error), COLOR)


def lenses(told) -> Iterator[Outcome]:
    """Samples at the rim of the opening; a fisheye of 359 degrees; both against double."""
    view = cameras(64)["depth_of_field"]
    edges = np.array([0, 1e-7, 0.5, 1 - 2.0**-24])
    u = np.stack(np.meshgrid([0.5], [0.5], edges, edges, [0.5]), axis=-1).reshape(-1, 5)
    pixel = np.full((len(u), 2), 13.0)
    yield Outcome("lens samples at the rim", "rays", _apart(view, pixel, u), 1e-5)
    size = np.array([64.0, 64.0])
    half = np.deg2rad(179.5)
    lens = Fisheye(*map(edge.single, (32 / half * np.ones(2), size / 2, half)))
    wide = eqx.tree_at(lambda c: c.lens, view, lens)
    # As far as the picture's circle reaches on its axes and diagonals, and the corners beyond it.
    grid = np.stack(np.meshgrid(np.arange(64.0), np.arange(64.0)), axis=-1).reshape(-1, 2)
    u = np.full((len(grid), 5), 0.5)
    yield Outcome("359-degree fisheye", "rays", _apart(wide, grid, u), 1e-5)
    shown, _ = edge.many(min(told.gaussians, 20000), 8)
    rays = camera_rays(wide, edge.single(grid), edge.single(u))
    yield from against_exact("359-degree fisheye", still(shown), rays, min(told.checked, 64))


def _apart(camera: Camera, pixel, u) -> float:
    """Largest difference of rays from those of double precision."""
    found = jax.jit(camera_rays)(camera, edge.single(pixel), edge.single(u))
    with jax.enable_x64(True):
        double = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float64), camera)
        given = (jnp.asarray(np.float32(x), jnp.float64) for x in (pixel, u))
        truth = jax.jit(camera_rays)(double, *given)
        parts = (found.origin, truth.origin), (found.direction, truth.direction)
        return max(float(np.max(np.abs(np.asarray(a) - np.asarray(b)))) for a, b in parts)


def times(told) -> Iterator[Outcome]:
    """An exposure as long as the clip, times outside of it, planes of half the digits."""
    scene = dynamic_room(min(told.gaussians, 5000))
    view = cameras(32)["pinhole"]
    whole = eqx.tree_at(lambda c: c.shutter.exposure, view, edge.single(1.0))
    frame = Renderer(scene, options=RenderOptions(samples=16))(whole)
    chosen = np.random.default_rng(0).choice(32 * 32, 64, replace=False)
    truth = exact.picture(scene, whole, chosen, samples=16)
    error = np.mean(np.abs(frame.color.reshape(-1, 3)[chosen] - truth))
    yield Outcome("exposure across the clip", "colour (key states)", float(error), 5e-3)
    state = jax.jit(at)
    for end, beyond in ((0.0, (-1.0, -1e6)), (1.0, (2.0, 1e6))):
        border = state(scene, edge.single(end))
        for moment in beyond:
            there = state(scene, edge.single(moment))
            gap = jax.tree.map(lambda a, b: float(jnp.max(jnp.abs(a - b))), border, there)
            yield Outcome(f"time {moment:g} of 0 ... 1", "state", max(jax.tree.leaves(gap)), 0)
    field = scene.deformation
    half = jax.tree.map(lambda x: x.astype(jnp.bfloat16), (field.planes.space, field.planes.time))
    rough = eqx.tree_at(
        lambda s: (s.deformation.planes.space, s.deformation.planes.time), scene, half
    )
    color, other = (
        Renderer(s, options=RenderOptions(samples=1))(view).color for s in (scene, rough)
    )
    finite = np.all(np.isfinite(other)) and other.dtype == color.dtype
    error = float(np.mean(np.abs(color - other))) if finite else np.inf
    yield Outcome("bfloat16 planes", "colour to float32 planes", error, 5e-3)


def backends(told) -> Iterator[Outcome]:
    """Kernel and arrays show the same, where there is a kernel."""
    if not on_kernel(TraceOptions(), jnp.float32):
        return
    shown, rays = edge.many(min(told.gaussians, 50000), min(told.side, 128))
    one, other = (look(still(shown), rays, backend=b)[0].color for b in ("kernel", "array"))
    yield Outcome("kernel and arrays", "colour", float(jnp.mean(jnp.abs(one - other))), COLOR)


GROUPS: tuple[Callable[..., Iterator[Outcome]], ...] = (
    common, dark, ties, lenses, times, backends, sizes,
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gaussians", type=int, default=20000)
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--checked", type=int, default=16, help="rays that brute force follows")
    parser.add_argument("--only", default="", help="groups or cases whose name holds this")
    told = parser.parse_args()
    began, failed = time.perf_counter(), 0
    print("| case | figure | measured | limit | |\n| --- | --- | --- | --- | --- |")
    for group in GROUPS:
        inside = group is sizes and told.only
        if told.only not in group.__name__ and not inside:
            continue
        for o in group(told):
            failed += not o.held
            word = "held" if o.held else "FAILED"
            print(f"| {o.case} | {o.figure} | {o.value:.1e} | {o.limit:.1e} | {word} |", flush=True)
    seconds = time.perf_counter() - began
    print(f"{failed} failed, {seconds:.0f} s on {jax.devices()[0].device_kind}")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
