"""Transient Gaussians on a generated room: does a picture cost what is alive, or what there is?

python -m benchmarks.bench_transient [--gaussians 100000] [--share 0.1] [--side 128]

Three scenes that give the same picture at one time: all transient Gaussians, of which a share is
alive; only those that are alive; and these as static Gaussians of the same opacity.
`max_difference` is from the picture of the first one.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.problem import room, room_rays
from benchmarks.record import backend, begin, record, show, timed
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.transient import Transients, transients_at
from gaussray.tracer.bundle import morton_tiles
from gaussray.tracer.measure import measure
from gaussray.tracer.motion import Motion, still
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.prepare import prepare, time_span
from gaussray.tracer.trace import trace


# When the picture is taken; the clip lasts from 0 to 1.
NOW = 0.5


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--share", type=float, default=0.1)
    parser.add_argument("--side", type=int, default=128)
    chosen = parser.parse_args(argv)
    order = np.maximum(morton_tiles(chosen.side, chosen.side, 8, 1), 0)
    rays = replace(room_rays(chosen.side, order), time=jnp.full(len(order), NOW, jnp.float32))
    options = TraceOptions(backend=backend(chosen.backend))
    rows, first = [], None
    for name, motion in scenes(chosen.gaussians, chosen.share, rays, options).items():
        found, picture = measured(name, motion, rays, options)
        first = picture if first is None else first
        rows += [row | {"max_difference": float(np.abs(picture - first).max())} for row in found]
    show(rows, "scene", "gaussians", "alive", "direction", "run_s_median", "max_difference")


def scenes(count: int, share: float, rays, options: TraceOptions) -> dict[str, Motion]:
    """The three scenes."""
    nothing = still(jax.tree.map(lambda x: x[:1], replace(room(8), opacity=jnp.zeros(8))))
    every = transients(room(count), share)
    motion = replace(nothing, transient=every)
    capacity = measure(motion, rays, options=options)
    chosen = prepare(motion, time_span(rays), options=options, capacity=capacity).living
    index = np.asarray(chosen.index) if chosen else np.arange(0)
    alive = jax.tree.map(lambda x: x[index[index >= 0]], every)
    return {
        "clip": motion,
        "alive": replace(nothing, transient=alive),
        "static": still(transients_at(alive, jnp.float32(NOW))),
    }


def transients(gaussians: Gaussians, share: float) -> Transients:
    """Gaussians at instants all over the clip, of which about a share is alive at any time."""
    count, dice = gaussians.count, np.random.default_rng(2)
    # A Gaussian of opacity 0.8 is alive for 6.5 lifetimes.
    lifetime = np.full(count, share / 6.5)
    numbers = dice.uniform(0, 1, count), lifetime, np.zeros(count)
    instant, lifetime, plateau = (jnp.asarray(x, jnp.float32) for x in numbers)
    g, velocity = gaussians, jnp.asarray(dice.normal(0, 0.5, (count, 3)), jnp.float32)
    parts = g.mean, velocity, g.quat, g.scale, g.opacity, g.harmonics
    return Transients(*parts, instant, lifetime, plateau)


def measured(name: str, motion: Motion, rays, options: TraceOptions):
    """Times of a scene forward and backward, and its picture."""
    capacity = measure(motion, rays, options=options)

    def forward(motion):
        return trace(motion, rays, options=options, capacity=capacity)

    def loss(motion):
        return jnp.mean(forward(motion)[0].color ** 2)

    pixels, report = jax.jit(forward)(motion)
    rows = [
        record(
            "transient",
            scene=name,
            gaussians=motion.transient.count if motion.transient else motion.gaussians.count,
            alive=int(report.needed[-1]) if motion.transient else motion.gaussians.count,
            rays=len(rays.time),
            k=options.k,
            backend=options.backend,
            direction=direction,
            **timed(jax.jit(function), motion),
            dropped=int(report.dropped),
        )
        for direction, function in (("forward", forward), ("forward_backward", jax.grad(loss)))
    ]
    return rows, np.asarray(pixels.color)


if __name__ == "__main__":
    main()
