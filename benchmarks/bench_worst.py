"""Worst cases: scenes that cost more than their number of Gaussians tells.

python -m benchmarks.bench_worst [--count 20000] [--side 270] [--cases room nested ...]
python -m benchmarks.bench_worst --scene SCENE.npz --cameras transforms.json

Every case is the generated room with one thing changed, seen by the pinhole camera of the room:

* size: pictures of a side that is a multiple of 16, and of one that is not.
* large, long: Gaussians 6 times as large, or 20 times as long along one axis.
* transparent: opacities between 0.02 and 0.05, so that no ray ends early.
* nested: half of the Gaussians are nearly concentric, from a point to the whole room.
* cluster: half of them in a ball of 2 cm.
* inside: half of them around the camera, which stands within many.
* fast: a tenth of them moves, and a rolling shutter reads for an interval of the capture.

`ns_a_hit` is the time of a frame divided by its hits; `against_room` divides it by the room's, in
the same run. Goal: never above 4. Where gsplat can be used (`peer.py`) it renders the same
Gaussians, standing still, in the same process. Goal: never above 3 times its 3dgut.
"""

from collections.abc import Callable, Sequence
from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from benchmarks import peer
from benchmarks.frames import Shot, filmed, true_pixels
from benchmarks.problem import EYE, cameras, dynamic_room, room
from benchmarks.record import begin, record, show
from gaussray.camera.camera import Camera
from gaussray.render import RenderOptions
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.scene import Scene
from gaussray.scene.store import load_scene
from gaussray.tracer.options import TraceOptions


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--side", type=int, default=270)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--scene", help="a trained scene, beside the room")
    parser.add_argument("--cameras", help="its cameras; the first one is used")
    chosen = parser.parse_args(argv)
    if bool(chosen.scene) != bool(chosen.cameras):
        parser.error("--scene and --cameras belong together")
    scenes = {"room": _room(chosen.count, chosen.side)}
    if chosen.scene:
        scenes[chosen.scene] = _trained(chosen.scene, chosen.cameras)
    else:
        scenes |= {name: CASES[name](chosen.count, chosen.side) for name in chosen.cases}
    rows = _measured(scenes, chosen)
    show(rows, *("scene", "gaussians", "hits_per_ray", "backend", "compile_s", "latency_s", "fps"),
         *("ns_a_hit", "against_room", "psnr_vs_exact", "max_error", "dropped"),
         *(peer.COLUMNS[:-1] if peer.usable() else ()))  # fmt: skip


def _measured(scenes: dict[str, tuple[Scene, Camera]], chosen) -> list[dict]:
    options, trace = RenderOptions(samples=1), TraceOptions(backend=chosen.backend)
    shots = [
        Shot(scene, camera, options, trace, partial(true_pixels, scene, camera, 1))
        for scene, camera in scenes.values()
    ]
    rows: list[dict] = []
    for name, (figures, _) in zip(scenes, filmed(shots, jobs=chosen.jobs), strict=True):
        hits = figures["hits_per_ray"] * figures["rays"]
        cost = 1e9 * figures["run_s_median"] / max(hits, 1)
        against = cost / rows[0]["ns_a_hit"] if rows else 1.0
        extra = {"ns_a_hit": cost, "against_room": against}
        extra |= peer.scene_columns(*scenes[name], figures["run_s_median"])
        rows.append(record("worst", effect="pinhole", scene=name, **figures, **extra))
    return rows


def _trained(scene: str, path: str) -> tuple[Scene, Camera]:
    from gaussray.capture.formats.paired import read_cameras

    return load_scene(scene), read_cameras(path)[0].camera


def _room(count: int, side: int) -> tuple[Scene, Camera]:
    return Scene(room(count)), cameras(side)["pinhole"]


def _size(count: int, side: int) -> tuple[Scene, Camera]:
    return _room(count, side // 16 * 16)


def _changed(change: Callable[[Gaussians, np.random.Generator], dict]) -> Callable:
    """A case: the room with other means, scales or opacities, given by field."""

    def case(count: int, side: int) -> tuple[Scene, Camera]:
        gaussians, camera = room(count), cameras(side)["pinhole"]
        new = change(gaussians, np.random.default_rng(2))
        values = [jnp.asarray(x, jnp.float32) for x in new.values()]
        return Scene(
            eqx.tree_at(lambda g: [getattr(g, name) for name in new], gaussians, values)
        ), camera

    return case


def _long(g: Gaussians, dice: np.random.Generator) -> dict:
    return {"scale": np.asarray(g.scale) * [20, 1, 1]}


def _transparent(g: Gaussians, dice: np.random.Generator) -> dict:
    return {"opacity": dice.uniform(0.02, 0.05, g.count)}


def _nested(g: Gaussians, dice: np.random.Generator) -> dict:
    mean, scale = np.array(g.mean), np.array(g.scale)
    half = g.count // 2
    size = np.geomspace(1e-3, 3, half)[:, None]
    # Centres apart, or the order of hits would be open.
    mean[:half] = np.array([0, 0, -0.4]) + 0.1 * size * dice.normal(size=(half, 3))
    scale[:half] = size
    opacity = np.array(g.opacity)
    opacity[:half] = 0.02
    return {"mean": mean, "scale": scale, "opacity": opacity}


def _cluster(g: Gaussians, dice: np.random.Generator) -> dict:
    mean, scale = np.array(g.mean), np.array(g.scale)
    half = g.count // 2
    mean[:half] = np.array([0, 0, -0.4]) + 0.02 * dice.normal(size=(half, 3))
    scale[:half] = 0.002
    return {"mean": mean, "scale": scale}


def _inside(g: Gaussians, dice: np.random.Generator) -> dict:
    mean, scale, opacity = np.array(g.mean), np.array(g.scale), np.array(g.opacity)
    half = g.count // 2
    mean[:half] = EYE + 0.3 * dice.normal(size=(half, 3))
    scale[:half], opacity[:half] = 0.03, 0.02
    return {"mean": mean, "scale": scale, "opacity": opacity}


def _fast(count: int, side: int) -> tuple[Scene, Camera]:
    return dynamic_room(count), cameras(side)["rolling_shutter"]


CASES = {
    "size": _size,
    "large": _changed(lambda g, dice: {"scale": 6 * np.asarray(g.scale)}),
    "long": _changed(_long),
    "transparent": _changed(_transparent),
    "nested": _changed(_nested),
    "cluster": _changed(_cluster),
    "inside": _changed(_inside),
    "fast": _fast,
}


if __name__ == "__main__":
    main()
