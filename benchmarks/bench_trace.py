"""The tracer on a generated room: time and error by k, forward and backward.

python benchmarks/bench_trace.py [--gaussians 10000] [--side 128]
"""

import argparse
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gaussians", type=int, nargs="+", default=[10_000])
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("--k", type=int, nargs="+", default=[4, 8, 16])
    chosen = parser.parse_args()
    from benchmarks.problem import record, room, room_rays, show, timed, use_all_cores
    from gaussray.tracer.bundle import tiles
    from gaussray.tracer.motion import still
    from gaussray.tracer.shard import mesh, trace_sharded
    from gaussray.tracer.trace import TraceOptions, measure
    from tests import reference

    use_all_cores()
    rows, devices = [], mesh()
    for count in chosen.gaussians:
        scene = room(count)
        order = tiles(chosen.side, chosen.side, 8, 1)
        order = np.where(order < 0, 0, order)
        rays = room_rays(chosen.side, order)
        checked = np.random.default_rng(0).choice(len(order), 500, replace=False)
        part = jax.tree.map(lambda x: x[checked], rays)  # noqa: B023
        truth = reference.trace(still(scene), part)[0]
        for k in chosen.k:
            options = TraceOptions(k=k)
            capacity = measure(still(scene), rays, options=options)

            def forward(gaussians, rays, options=options, capacity=capacity):
                return trace_sharded(
                    still(gaussians), rays, options=options, capacity=capacity, mesh=devices
                )

            def loss(gaussians, rays, forward=forward):
                return jnp.mean(forward(gaussians, rays)[0].color ** 2)

            run = jax.jit(forward)
            pixels, report = run(scene, rays)
            error = np.abs(np.asarray(pixels.color)[checked] - truth)
            for direction, function in (("forward", run), ("forward_backward", jax.grad(loss))):
                figures = timed(jax.jit(function), scene, rays)
                rows.append(
                    record(
                        "trace",
                        effect="pinhole",
                        scene="room",
                        gaussians=count,
                        rays=len(order),
                        k=k,
                        backend="array",
                        direction=direction,
                        **figures,
                        fps=1 / figures["run_s_median"],
                        rays_per_s=len(order) / figures["run_s_median"],
                        mean_error=float(error.mean()),
                        max_error=float(error.max()),
                        psnr_vs_exact=float(-10 * np.log10(np.mean(error**2))),
                        dropped=int(report.dropped),
                    )
                )
    columns = ("gaussians", "k", "direction", "run_s_median", "fps", "mean_error", "max_error")
    show(rows, (*columns, "dropped"))


if __name__ == "__main__":
    main()
