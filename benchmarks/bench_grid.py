"""What precedes the march: order and boxes of the Gaussians, and lists of candidates.

python -m benchmarks.bench_grid [--gaussians 10000] [--side 128] [--keys 1 3]

`order` sorts the Gaussians along the grid and bounds each cell (grid.build, or the kernel's rows
and boxes); `lists` is everything up to the march. More than one key state means that a tenth of the
Gaussians moves.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.problem import INSTANTS, dynamic_room, room_rays
from benchmarks.record import backend, begin, on_cuda, record, show, timed
from gaussray.camera.rays import Rays
from gaussray.scene.scene import Scene, at, moving_at
from gaussray.tracer import kernel
from gaussray.tracer.bundle import morton_tiles
from gaussray.tracer.grid import build_grid
from gaussray.tracer.kernel_layout import gaussian_rows, grid_boxes
from gaussray.tracer.measure import measure
from gaussray.tracer.motion import Motion, merge_rest, still
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.prepare import time_span
from gaussray.tracer.trace import find_candidates
from gaussray.tracer.traverse import Capacity


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--gaussians", type=int, nargs="+", default=[10_000])
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("--keys", type=int, nargs="+", default=[1, 3])
    chosen = parser.parse_args(argv)
    options = TraceOptions(backend=backend(chosen.backend))
    order = np.maximum(morton_tiles(chosen.side, chosen.side, options.bundle, options.levels), 0)
    rows = []
    for count in chosen.gaussians:
        scene = dynamic_room(count)
        for keys in chosen.keys:
            motion = moved(scene, keys)
            rays = room_rays(chosen.side, order)
            # Rows of the picture are read one after the other, for one interval of the capture.
            late = (order // chosen.side / chosen.side - 0.5) / (INSTANTS - 1)
            time = jnp.asarray(0.5 + late * (keys > 1), jnp.float32)
            rays = jax.tree.map(lambda x: x[None], Rays(rays.origin, rays.direction, time))
            for name, function, lost in stages(motion, rays, options):
                figures = timed(function, motion, rays)
                rows.append(
                    record(
                        "grid",
                        effect=name,
                        scene="dynamic_room",
                        gaussians=count,
                        rays=len(order),
                        samples=1,
                        keys=keys,
                        backend=options.backend,
                        direction="forward",
                        **figures,
                        dropped=lost(function(motion, rays)),
                    )
                )
    show(rows, "effect", "gaussians", "keys", "backend", "compile_s", "run_s_median", "dropped")


def moved(scene: Scene, keys: int) -> Motion:
    """The scene in the middle of the capture, with so many key states over one interval."""
    if keys == 1:
        return still(jax.jit(at)(scene, jnp.float32(0.5)))
    half = 0.5 / (INSTANTS - 1)
    time = jnp.linspace(0.5 - half, 0.5 + half, keys, dtype=jnp.float32)
    return Motion(time, jax.jit(moving_at)(scene, time), scene.static)


def stages(motion: Motion, rays: Rays, options: TraceOptions):
    """Name, compiled function and entries dropped of its result."""
    capacity = measure(motion, rays, options=options)
    make = _kernel if on_cuda(options.backend) else _arrays
    order, lists, lost = make(options, capacity)
    return (("order", jax.jit(order), lambda _: 0), ("lists", jax.jit(lists), lost))


def _arrays(options: TraceOptions, capacity: Capacity):
    def order(motion, rays):
        return build_grid(merge_rest(motion), alpha_min=options.alpha_min)

    def lists(motion, rays):
        return find_candidates(merge_rest(motion), rays, options=options, capacity=capacity)

    return order, lists, lambda result: int(result[0].dropped)


def _kernel(options: TraceOptions, capacity: Capacity):
    def order(motion, rays):
        motion = merge_rest(motion) if motion.keys == 1 else motion
        made, box, kept, _ = gaussian_rows(motion, options.alpha_min, time_span(rays))
        return made, grid_boxes(box, kept)

    def lists(motion, rays):
        stage, strips = kernel.kernel_inputs(
            motion, rays, time_span(rays), options=options, slots=capacity.slots
        )
        # The lists of one strip: all there are, unless the picture is very large.
        return kernel.candidate_lists(stage, jax.tree.map(lambda x: x[0], strips))

    def lost(result) -> int:
        return int(np.sum(np.maximum(np.asarray(result.count) - capacity.slots, 0)))

    return order, lists, lost


if __name__ == "__main__":
    main()
