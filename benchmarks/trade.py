"""Speed against accuracy: every knob turned by itself, each point with frames per second and error.

python -m benchmarks.trade [--room 2000] [--side 64] [--axes k alpha_min ...] [--quick]
python -m benchmarks.trade --scene RUN

From k = 8, the published cut-offs, bundles of 8 x 8 and key states as many as it takes, on the
generated dynamic room or a trained scene:

  preset        conf/trace: exact, default, fast; a pinhole's frame
  k, alpha_min, transmittance_min, bundle    a pinhole's frame
  time          key states (2, 3, 5) against blocks of 16, 4 and 1 rows of a rolling shutter
  lens          rays a pixel through an aperture
  harmonics     degrees left of a scene of degree 3
  half          planes kept in half precision (the program reads them so), colours rounded to it
                (a round trip: rows of the tracer are of single precision, so its time is the same)

Frames are made and timed as by bench_render. `psnr_vs_exact` and `max_error` are against double
precision without cut-offs (alpha_min 1e-5, transmittance to the end), every ray at its own time,
256 rays a pixel through an aperture and the scene whole; `psnr_same_cutoff` is against the same
with the point's own alpha_min, whose cut-off is the largest error of most points and belongs to a
scene that was trained with it.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from benchmarks import exact
from benchmarks.frames import Shot, filmed
from benchmarks.problem import SAMPLE, cameras, dynamic_room
from benchmarks.record import begin, record, show
from gaussray.camera.camera import Camera
from gaussray.render import RenderOptions
from gaussray.scene.scene import Scene
from gaussray.scene.store import load_scene
from gaussray.tracer.options import TraceOptions


AXES = (
    "preset",
    "k",
    "alpha_min",
    "transmittance_min",
    "bundle",
    "time",
    "lens",
    "harmonics",
    "half",
)
NO_CUT = 1e-5
# Rays a pixel of the exact picture through an aperture, and pixels that are compared are as many as
# could be afforded with so many.
LENS, LENS_FOR_PIXELS = 256, 64


# What conf/trace/<name>.yaml changes.
PRESETS: dict[str, dict[str, Any]] = {
    "exact": {"k": 16, "transmittance_min": 0.0},
    "default": {"k": 16},
    "fast": {"k": 16, "alpha_min": 1 / 64, "transmittance_min": 1e-2},
}


class Point(NamedTuple):
    """One setting of one knob; `change` makes its scene, named by `variant`, of the given one."""

    axis: str
    setting: str
    effect: str = "pinhole"
    trace: dict[str, Any] = {}
    options: dict[str, Any] = {}
    variant: str = ""
    change: Callable[[Scene], Scene] | None = None


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--room", type=int, default=2_000, help="Gaussians in the room")
    parser.add_argument("--scene", help="folder or file of a trained scene instead")
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--axes", nargs="+", choices=AXES, default=AXES)
    parser.add_argument("--quick", action="store_true", help="ends of the axes only, and k")
    chosen = parser.parse_args(argv)
    problem = _trained(chosen.scene) if chosen.scene else _generated(chosen.room, chosen.side)
    truths, wanted, shots = Truths(problem), [], {}
    for point in points(chosen.quick):
        whole = problem.scene if point.axis != "harmonics" else problem.colorful
        if point.axis in chosen.axes and whole is not None:
            # Knobs at their base are one measurement; the scenes of `harmonics` are others.
            key = (point.effect, *_options(point, chosen.backend), point.variant)
            wanted.append((point, key))
            if key not in shots:
                shots[key] = _shot(point, problem, whole, truths, chosen.backend)
    figures = dict(zip(shots, filmed(list(shots.values()), jobs=chosen.jobs), strict=True))
    rows = []
    for point, key in wanted:
        own, (_, color) = figures[key]
        same = truths(point, shots[key].trace.alpha_min)
        own = own | {"psnr_same_cutoff": exact.psnr(color, same)}
        setting = {"axis": point.axis, "setting": point.setting, "scene": problem.name}
        rows.append(record("trade", effect=point.effect, **setting, **own))
    names = ("axis", "setting", "effect", "backend", "compile_s", "fps", "psnr_vs_exact")
    show(rows, *names, "max_error", "psnr_same_cutoff", "dropped")


def points(quick: bool = False) -> Iterator[Point]:
    """Every point of the sweep."""

    def ends(*values):
        return (values[0], values[-1]) if quick else values

    for name, trace in PRESETS.items():
        yield Point("preset", name, trace=trace)
    for k in (4, 8, 16, 32):
        yield Point("k", str(k), trace={"k": k})
    for share in ends(32, 64, 255, 1000):
        yield Point("alpha_min", f"1/{share}", trace={"alpha_min": 1 / share})
    for floor in ends(1e-1, 1e-2, 1e-3, 1e-4, 0.0):
        yield Point("transmittance_min", f"{floor:g}", trace={"transmittance_min": floor})
    for side in ends(4, 8, 16):
        yield Point("bundle", str(side), trace={"bundle": side})
    for keys in ends(2, 3, 5):
        yield Point("time", f"{keys} keys", "rolling_shutter", options={"keys": keys})
    for block in ends(16, 4, 1):
        rows = {"chunk_rows": block}
        yield Point("time", f"{block} rows", "rolling_shutter", options=rows)
    for samples in ends(1, 4, 16, 64):
        yield Point("lens", str(samples), "depth_of_field", options={"samples": samples})
    for degree in ends(0, 1, 2, 3):
        yield Point(
            "harmonics",
            f"degree {degree}",
            variant=f"degree {degree}",
            change=lambda scene, degree=degree: _truncated(scene, degree),
        )
    for kind in ends(jnp.bfloat16, jnp.float16):
        name = jnp.dtype(kind).name
        for part, change in (("planes", _half_planes), ("colours", _half_colors)):
            yield Point(
                "half",
                f"{part} {name}",
                variant=f"{part} {name}",
                change=lambda scene, kind=kind, change=change: change(scene, kind),
            )


class Problem(NamedTuple):
    """A scene and its cameras, and the same with harmonics of degree 3 (None if it has none)."""

    name: str
    scene: Scene
    colorful: Scene | None
    cameras: dict[str, Camera]


def _generated(count: int, side: int) -> Problem:
    return Problem(
        "dynamic_room", dynamic_room(count), dynamic_room(count, degree=3), cameras(side)
    )


def _trained(path: str) -> Problem:
    from gaussray.capture.formats.paired import read_capture

    scene, capture = load_scene(path), read_capture(SAMPLE)
    views = {name: own[0].camera for name, own in capture.effects.items()}
    views["pinhole"] = next(v.camera for v in capture.views if v.split == "test")
    colorful = scene if scene.static.harmonics.shape[1] > 1 else None
    return Problem(path, scene, colorful, views)


class Truths:
    """Exact colours of the compared pixels, each worked out once."""

    def __init__(self, problem: Problem):
        self._problem = problem
        self._known: dict[tuple, np.ndarray] = {}
        self._turn = threading.Lock()

    def pixels(self, effect: str) -> np.ndarray:
        """Numbers of the pixels that are compared."""
        film, scene = self._problem.cameras[effect].film, self._problem.scene
        samples = LENS_FOR_PIXELS if effect == "depth_of_field" else 1
        gaussians = scene.count
        return exact.checked(film.width * film.height, gaussians, samples)

    def __call__(self, point: Point, alpha_min: float) -> np.ndarray:
        effect, colorful = point.effect, point.axis == "harmonics"
        with self._turn:
            if (effect, colorful, alpha_min) not in self._known:
                own = self._problem
                self._known[effect, colorful, alpha_min] = exact.picture(
                    own.colorful or own.scene if colorful else own.scene,
                    self._problem.cameras[effect],
                    self.pixels(effect),
                    samples=LENS if effect == "depth_of_field" else 1,
                    alpha_min=alpha_min,
                )
            return self._known[effect, colorful, alpha_min]


def _shot(point: Point, problem: Problem, whole: Scene, truths: Truths, backend: str) -> Shot:
    trace, options = _options(point, backend)
    scene = point.change(whole) if point.change else whole

    def truth():
        return truths.pixels(point.effect), truths(point, NO_CUT)

    return Shot(scene, problem.cameras[point.effect], options, trace, truth)


def _options(point: Point, backend: str) -> tuple[TraceOptions, RenderOptions]:
    return (
        TraceOptions(**({"k": 8, "backend": backend} | point.trace)),
        RenderOptions(**({"samples": 1} | point.options)),
    )


def _truncated(scene: Scene, degree: int) -> Scene:
    def where(s: Scene):
        return s.static.harmonics, s.moving.harmonics

    return eqx.tree_at(where, scene, tuple(x[:, : (degree + 1) ** 2] for x in where(scene)))


def _half_planes(scene: Scene, kind) -> Scene:
    if scene.deformation is None:
        return scene

    def where(s: Scene):
        return s.deformation.planes.space, s.deformation.planes.time  # type: ignore[union-attr]

    halves = tuple(tuple(x.astype(kind) for x in planes) for planes in where(scene))
    return eqx.tree_at(where, scene, halves)


def _half_colors(scene: Scene, kind) -> Scene:
    def where(s: Scene):
        return s.static.harmonics, s.moving.harmonics

    rounded = tuple(x.astype(kind).astype(x.dtype) for x in where(scene))
    return eqx.tree_at(where, scene, rounded)


if __name__ == "__main__":
    main()
