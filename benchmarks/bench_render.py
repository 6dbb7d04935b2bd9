"""Frames per second, effect by effect.

python -m benchmarks.bench_render --room 50000 [--side 512] [--k 8]
python -m benchmarks.bench_render --scene RUN [--frames 6]

`--room` films the generated dynamic room: each frame makes its rays, deforms the scene for its
times, builds the grid and traces, and the picture stays on the device; frames follow each other
without waiting, and whether lists were long enough is asked at the end. Depth of field, motion blur
and everything at once (a fisheye with an aperture, a rolling shutter, an exposure and a moving
camera) take 16 rays a pixel, the others one; a pinhole of 16 tells what rays alone cost. The
rolling shutter reads for one interval of the capture, with key states (every ray has its own time),
in blocks of 16 rows and row by row (the paper's way).

`--scene` films a trained scene at the sample capture's held-out cameras and fetches every picture.

Errors are against double precision in random pixels, each ray at its own time. Where gsplat can be
used (`peer.py`) it renders the pinhole's Gaussians, standing still, in the same process.
"""

from collections.abc import Sequence
from functools import cache, partial
from itertools import product

import numpy as np

from benchmarks import exact, peer
from benchmarks.frames import Shot, filmed, true_pixels
from benchmarks.problem import SAMPLE, cameras, dynamic_room
from benchmarks.record import backend, begin, record, show
from gaussray.render import Renderer, RenderOptions
from gaussray.scene.store import load_scene
from gaussray.tracer.options import TraceOptions


# Rays a pixel, and rows in a block (0: key states), of what is filmed in the room.
ROOM = {
    "pinhole": (1, 0),
    "fisheye": (1, 0),
    "depth_of_field": (16, 0),
    "rolling_shutter": (1, 0),
    "rolling_shutter_16_rows": (1, 16),
    "rolling_shutter_1_row": (1, 1),
    "moving_camera": (1, 0),
    "pinhole_16_rays": (16, 0),
    "motion_blur": (16, 0),
    "everything": (16, 0),
}
# Which camera films what has no camera of its own name.
CAMERA = {
    "rolling_shutter_16_rows": "rolling_shutter",
    "rolling_shutter_1_row": "rolling_shutter",
    "pinhole_16_rays": "pinhole",
}
# Rays a pixel in the sample capture; what is not listed takes 16.
SAMPLE_RAYS = {"pinhole": 1, "rolling_shutter": 1, "fisheye": 4}


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--room", type=int, nargs="+", help="Gaussians in the generated room")
    source.add_argument("--scene", help="folder or file of a trained scene")
    parser.add_argument("--side", type=int, default=512)
    parser.add_argument("--effects", nargs="+", choices=list(ROOM), default=list(ROOM))
    parser.add_argument("--k", type=int, nargs="+", default=[8])
    parser.add_argument("--frames", type=int, default=6)
    chosen = parser.parse_args(argv)
    rows = in_capture(chosen) if chosen.scene else in_room(chosen)
    names = ("effect", "gaussians", "samples", "k", "backend", "compile_s", "latency_s", "fps")
    peers = peer.COLUMNS[:-1] if peer.usable() and chosen.room else ()
    show(rows, *names, "psnr_vs_exact", "max_error", "dropped", *peers)


def in_room(chosen) -> list[dict]:
    """Lines of the generated room."""
    shots, names = [], []
    for count in chosen.room:
        scene, views = dynamic_room(count), cameras(chosen.side)
        # One truth for all that have the same camera and rays.
        truth = {
            (kind, samples): cache(partial(true_pixels, scene, views[kind], samples))
            for kind, samples in {_shot(effect) for effect in chosen.effects}
        }
        for effect, k in product(chosen.effects, chosen.k):
            kind, samples = _shot(effect)
            options = RenderOptions(samples=samples, chunk_rows=ROOM[effect][1])
            trace = TraceOptions(k=k, backend=chosen.backend)
            shots.append(Shot(scene, views[kind], options, trace, truth[kind, samples]))
            names.append(effect)
    rows = []
    for effect, shot, (figures, _) in zip(
        names, shots, filmed(shots, jobs=chosen.jobs), strict=True
    ):
        if effect == "pinhole":
            figures |= peer.scene_columns(shot.scene, shot.camera, figures["run_s_median"])
        rows.append(record("render", effect=effect, scene="dynamic_room", **figures))
    return rows


def _shot(effect: str) -> tuple[str, int]:
    """Name of an effect's camera, and its rays a pixel."""
    return CAMERA.get(effect, effect), ROOM[effect][0]


def in_capture(chosen) -> list[dict]:
    """Lines of a trained scene."""
    from gaussray.capture.formats.paired import read_capture

    scene, capture = load_scene(chosen.scene), read_capture(SAMPLE)
    views = {"pinhole": [v for v in capture.views if v.split == "test"], **capture.effects}
    rows = []
    for effect, own in views.items():
        samples = SAMPLE_RAYS.get(effect, 16)
        own = own[:: max(len(own) // chosen.frames, 1)][: chosen.frames]
        where, truth = true_pixels(scene, own[0].camera, samples)
        for k in chosen.k:
            trace = TraceOptions(k=k, backend=chosen.backend)
            renderer = Renderer(scene, options=RenderOptions(samples=samples), trace=trace)
            first = renderer(own[0].camera)
            seconds = [renderer(view.camera).seconds for view in own for _ in range(2)]
            film, middle = own[0].camera.film, float(np.median(seconds))
            rows.append(
                record(
                    "render",
                    effect=effect,
                    scene=str(chosen.scene),
                    gaussians=scene.count,
                    rays=film.width * film.height * samples,
                    samples=samples,
                    k=k,
                    backend=backend(chosen.backend),
                    direction="forward",
                    compile_s=round(first.seconds - min(seconds), 3),
                    run_s_median=middle,
                    run_s_min=min(seconds),
                    latency_s=middle,
                    **exact.errors(first.color.reshape(-1, 3)[where], truth),
                    hits_per_ray=first.hits / (film.width * film.height * samples),
                    dropped=0,
                )
            )
    return rows


if __name__ == "__main__":
    main()
