"""Captures that give a fit next to nothing to hold on to: does every number stay finite?

python -m experiments.extremes.training [--steps 100000] [--only NAME]
"""

import experiments.extremes.alone  # noqa: F401, I001  (first: it stands in for what is missing)

import argparse
import functools
import json
import math
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.reconstruct import loop, pipeline as stage, start
from gaussray.camera.aperture import no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import pinhole
from gaussray.camera.shutter import Shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.reconstruct.data import pictures as footage
from gaussray.capture.capture import Capture, View
from gaussray.capture.points import Points
from gaussray.color import srgb_encode
from gaussray.reconstruct.options import FitOptions
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.initialize.body_tracking import TrackOptions
from gaussray.reconstruct.data.motion_mask import point_activity as activity
from gaussray.geometry import quaternion
from gaussray.reconstruct import ReconstructOptions
from gaussray.render import Renderer, RenderOptions
from gaussray.reconstruct.simplify.prune import PruneOptions
from gaussray.scene.deformation import FieldOptions
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics
from gaussray.scene.scene import Scene
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.traverse import Capacity
from gaussray.reconstruct.block_sizes import BlockSizes


SIDE, TIMES = 32, np.linspace(0, 1, 4)
ANGLES = (-0.45, -0.15, 0.15, 0.45)


class Case(NamedTuple):
    """What is filmed: everything white, black or grey if `light` is a number; from `angles` around
    a scene in units of `unit`, with or without starting points. All Gaussians may move, so that
    most cases share what is compiled, unless what the pictures show at rest `rests`."""

    light: float | None = None
    angles: tuple[float, ...] = ANGLES
    unit: float = 1.0
    points: bool = True
    rests: bool = False
    refine: tuple[str, ...] = ()


# Units are powers of two: what does not depend on them is the same to the last bit.
CASES = {
    "ordinary": Case(),
    "units of 2^20 (1e6)": Case(unit=2.0**20),
    "units of 2^-20 (1e-6)": Case(unit=2.0**-20),
    "units of 2^40 (1e12)": Case(unit=2.0**40),
    "units of 2^-40 (1e-12)": Case(unit=2.0**-40),
    "all black": Case(light=0.0),
    "all white": Case(light=1.0),
    "constant colour": Case(light=0.3),
    "identical cameras": Case(angles=(0.1,) * 4),
    "all black, no points": Case(light=0.0, points=False),
    "no points": Case(points=False),
    "ordinary, with some at rest": Case(rests=True),
    "all black, all at rest": Case(light=0.0, rests=True),
    "one camera": Case(angles=ANGLES[:1]),
    "one camera, all refined": Case(
        angles=ANGLES[:1], refine=("pose", "lens", "shutter", "exposure", "offset")
    ),
}


# Lists as long as any case needs: cases of the same shapes share what is compiled.
ROOM = Capacity((4096,), 4096, 512)


def single(x):
    return jnp.asarray(x, jnp.float32)


def camera(angle: float, moment: float, unit: float = 1.0) -> Camera:
    """Looks at the origin from three units away."""
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    place = 3 * unit * np.array([-sin, 0, -cos])
    path = Trajectory(
        jnp.zeros(1, jnp.float32), quaternion(single(turn))[None], single(place)[None]
    )
    lens = pinhole(single([1.1 * SIDE] * 2), single([SIDE / 2] * 2))
    step = 0.1 / (SIDE - 1)
    shutter = Shutter(*map(single, (-0.05, step, 0)))
    opening = jax.tree.map(single, no_aperture())
    return Camera(Film(SIDE, SIDE, "center"), lens, opening, shutter, path, single(moment))


def matter(moment: float) -> Gaussians:
    """A wall of coloured Gaussians that rest, and a ball of others that goes along it."""
    dice = np.random.default_rng(0)
    wall = np.append(dice.uniform(-1, 1, (150, 2)), dice.uniform(0.4, 0.5, (150, 1)), axis=1)
    ball = 0.25 * dice.normal(size=(50, 3)) + [0.8 * moment - 0.4, 0.1, -0.3]
    color = single(dice.uniform(size=(200, 3)))
    return Gaussians(
        single(np.concatenate([wall, ball])), single(np.tile([1.0, 0, 0, 0], (200, 1))),
        single(np.full((200, 3), 0.12)), single(np.full(200, 0.9)), constant_harmonics(color, 0),
    )  # fmt: skip


@functools.cache
def pictures(light: float | None, angles: tuple[float, ...]) -> dict[Path, np.ndarray]:
    """What the cameras see, as the bytes of sRGB files; in every unit the same."""
    found = {}
    for moment in TIMES:
        still = matter(float(moment))
        scene = Scene(still, jax.tree.map(lambda x: x[:0], still), None, single([0, 1]))
        render = Renderer(scene, options=RenderOptions(samples=1))
        for i, angle in enumerate(angles):
            if light is None:
                seen = np.clip(render(camera(angle, float(moment))).color, 0, 1)
            else:
                seen = np.full((SIDE, SIDE, 3), light, np.float32)
            found[Path(f"{i}/{moment:.3f}")] = np.round(255 * srgb_encode(seen)).astype(np.uint8)
    return found


def capture(case: Case) -> Capture:
    """A capture whose pictures are in memory."""
    views = [
        View(
            camera(angle, float(moment), case.unit), Path(f"{i}/{moment:.3f}"), None, None,
            f"cam{i}", "train", float(moment), "pinhole", 1, "srgb",
        )
        for i, angle in enumerate(case.angles)
        for moment in TIMES
    ]  # fmt: skip
    start = matter(0.0)
    points = Points(case.unit * np.asarray(start.mean), np.full((200, 3), 0.5, np.float32))
    return Capture(Path("."), views, {}, points if case.points else None, (0.0, 1.0), "normalised")


def options(steps: int, case: Case) -> ReconstructOptions:
    """Everything on: density control, all terms, tracked bodies."""
    coarse = max(steps // 10, 1)
    # All blocks of one length, so that each stage compiles once.
    block = math.gcd(coarse, 250)
    return ReconstructOptions(
        fit=FitOptions(
            auto=False, coarse=coarse, fine=steps, tiles=8, block=block, points=200, surround=0.0,
            refine=case.refine, checkpoint=1e9,
        ),
        track=TrackOptions(poses=32, rounds=2),
        field=FieldOptions(sides=(4, 8), channels=4, width=16),
        loss=LossOptions(l1=0.8, dssim=0.2),
        density=DensityOptions(interval=max(steps // 20, 1)),
        trace=TraceOptions(levels=0, transmittance_min=1e-2),
        prune=PruneOptions(loss=0.0),
    )  # fmt: skip


class Outcome(NamedTuple):
    """Mean loss of the first and of the last block of steps, PSNR over the latter, how many
    Gaussians were kept, and whether every number of the scene and the figures is finite."""

    first: float
    last: float
    psnr: float
    gaussians: int
    finite: bool


def fitted(case: Case, steps: int) -> Outcome:
    """What became of a fit."""
    held, told = pictures(case.light, case.angles), options(steps, case)
    footage.stream_encoded = lambda views: (
        np.dtype(np.uint8),
        ((i, held[view.image]) for i, view in enumerate(views)),
    )
    start.point_activity = activity if case.rests else lambda _, place: np.ones(len(place))
    loop.first_sizes = lambda session, state, batches: BlockSizes(
        ROOM, session.mesh, session.key_states(state)
    )
    with tempfile.TemporaryDirectory() as out:
        scene = stage.reconstruct(capture(case), out, options=told, quiet=True)
        lines = [json.loads(line) for line in (Path(out) / "metrics.jsonl").open()]
    figures = np.array([x for line in lines for x in line.values() if isinstance(x, float)])
    finite = all(np.isfinite(x).all() for x in [*jax.tree.leaves(scene), figures])
    terms = vars(told.loss)
    first, last = (
        sum(terms[name] * value for name, value in line.items() if name in terms)
        for line in (lines[0], lines[-1])
    )
    count = scene.count
    return Outcome(first, last, lines[-1]["psnr"], count, finite)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    told = parser.parse_args()
    failed = 0
    print("| case | steps | loss, first -> last | PSNR | Gaussians | s | |\n" + "| --- " * 7 + "|")
    for name, case in CASES.items():
        if told.only not in name:
            continue
        began = time.perf_counter()
        try:
            o = fitted(case, told.steps)
            cells = f"{o.first:.3g} -> {o.last:.3g} | {o.psnr:.1f} dB | {o.gaussians}"
            finite = o.finite
        except Exception as error:  # Whatever it is, the other cases go on.
            cells, finite = f"{type(error).__name__}: {error} | |", False
        failed += not finite
        seconds = time.perf_counter() - began
        word = "finite" if finite else "FAILED"
        print(f"| {name} | {told.steps} | {cells} | {seconds:.0f} | {word} |", flush=True)
    print(f"{failed} failed on {jax.devices()[0].device_kind}")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
