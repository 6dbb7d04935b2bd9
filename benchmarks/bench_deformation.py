"""The Gaussians that move, at the key times of a frame: forward, and the gradient in everything.

python -m benchmarks.bench_deformation [--gaussians 1000] [--keys 1 3 9]

`max_error` is that of the means, in scene units, against the same in double precision.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.problem import INSTANTS, dynamic_room
from benchmarks.record import begin, record, show, timed
from gaussray.scene.scene import moving_at


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--gaussians", type=int, nargs="+", default=[1_000], help="that move")
    parser.add_argument("--keys", type=int, nargs="+", default=[1, 3, 9])
    chosen = parser.parse_args(argv)
    forward = jax.jit(moving_at)
    backward = jax.jit(jax.grad(_loss))
    rows = []
    for count in chosen.gaussians:
        scene = dynamic_room(count, moving=1.0)
        for keys in chosen.keys:
            half = 0.5 / (INSTANTS - 1)
            time = jnp.linspace(0.5 - half, 0.5 + half, keys, dtype=jnp.float32)
            exact = _exact_mean(scene, time)
            for name, function in (("forward", forward), ("forward_backward", backward)):
                figures = timed(function, scene, time)
                error = np.abs(np.asarray(forward(scene, time).mean) - exact)
                rows.append(
                    record(
                        "deformation",
                        scene="dynamic_room",
                        gaussians=count,
                        keys=keys,
                        backend="array",
                        direction=name,
                        **figures,
                        max_error=float(error.max()),
                    )
                )
    show(rows, "gaussians", "keys", "direction", "compile_s", "run_s_median", "max_error")


def _loss(scene, time):
    g = moving_at(scene, time)
    return sum(jnp.mean(x**2) for x in (g.mean, g.quat, g.scale, g.tint))


def _exact_mean(scene, time) -> np.ndarray:
    with jax.enable_x64(True):
        scene, time = jax.tree.map(lambda x: jnp.asarray(np.asarray(x, np.float64)), (scene, time))
        return np.asarray(jax.jit(moving_at)(scene, time).mean)


if __name__ == "__main__":
    main()
