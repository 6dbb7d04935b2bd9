"""The tracer on a generated room: time and error by k, forward and backward.

python -m benchmarks.bench_trace [--gaussians 10000] [--side 128] [--k 4 8 16]

Rays and Gaussians are given: what is timed is the search for candidates and the march, and with
forward_backward the gradient of the mean square of the colours in every parameter. Where gsplat can
be used (`peer.py`) it renders the same picture in the same process.
"""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import exact, peer
from benchmarks.problem import cameras, room, room_rays
from benchmarks.record import backend, begin, record, show, timed
from gaussray.tracer.bundle import morton_tiles
from gaussray.tracer.measure import measure
from gaussray.tracer.motion import still
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.shard import mesh, trace_sharded


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--gaussians", type=int, nargs="+", default=[10_000])
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("--k", type=int, nargs="+", default=[4, 8, 16])
    chosen = parser.parse_args(argv)
    rows = []
    for count in chosen.gaussians:
        scene = room(count)
        order = np.maximum(morton_tiles(chosen.side, chosen.side, 8, 1), 0)
        rays = room_rays(chosen.side, order)
        some = exact.checked(len(order), count)
        truth = exact.color(still(scene), jax.tree.map(lambda x: x[some], rays))  # noqa: B023
        capacity = None
        for k in chosen.k:
            options = TraceOptions(k=k, backend=backend(chosen.backend))
            capacity = capacity or measure(still(scene), rays, options=options)
            rows += _measured(scene, rays, options, capacity, some, truth, order[some])
    names = ("gaussians", "k", "backend", "direction", "compile_s", "run_s_median", "latency_s")
    peers = peer.COLUMNS if peer.usable() else ()
    show(rows, *names, "psnr_vs_exact", "max_error", "dropped", *peers)


def _measured(scene, rays, options, capacity, some, truth, pixels_of_some) -> list[dict]:
    devices, view = mesh(), cameras(math.isqrt(len(rays.time)))["pinhole"]

    def forward(gaussians, rays):
        return trace_sharded(
            still(gaussians), rays, options=options, capacity=capacity, mesh=devices
        )

    def loss(gaussians, rays):
        return jnp.mean(forward(gaussians, rays)[0].color ** 2)

    run, rows = jax.jit(forward), []
    for direction, function in (("forward", run), ("forward_backward", jax.jit(jax.grad(loss)))):
        figures = timed(function, scene, rays)
        pixels, report = run(scene, rays)
        beside = peer.columns(
            scene,
            view,
            figures["run_s_median"],
            gradients=direction == "forward_backward",
            truth=(pixels_of_some, truth),
        )
        rows.append(
            record(
                "trace",
                effect="pinhole",
                scene="room",
                gaussians=scene.count,
                rays=len(rays.time),
                samples=1,
                k=options.k,
                backend=options.backend,
                direction=direction,
                **figures,
                **exact.errors(np.asarray(pixels.color)[some], truth),
                hits_per_ray=int(report.hits) / len(rays.time),
                dropped=int(report.dropped),
                **beside,
            )
        )
    return rows


if __name__ == "__main__":
    main()
