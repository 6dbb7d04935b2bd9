"""What `test_shard.py` runs where JAX has two devices: `trace_sharded` against `trace`."""

import equinox as eqx
import jax
import numpy as np
from scenes import COUNT, gaussians, rays, resting, score, shot, stacked, weights

from gaussray.tracer.options import TraceOptions
from gaussray.tracer.shard import mesh, trace_sharded
from gaussray.tracer.traverse import Capacity


jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_disable_most_optimizations", True)

# The same sums in another order, in single precision; gradients relative to the largest.
SAME, SLOPE = 1e-6, 1e-5
# 14 bundles of 2 x 2 rays and a part of one: a device has eight, and what is missing is padded.
OPTIONS = TraceOptions(k=4, bundle=2, levels=0, group=4, chunk=8, transmittance_min=0.0)
RAYS = 14 * 4 + 3
ROOM = Capacity((256,), 1024, 64)


@eqx.filter_jit
def pull(motion, rays, weight, capacity, mesh, presharded=False):
    def loss(motion, rays):
        pixels, report = trace_sharded(
            motion, rays, options=OPTIONS, capacity=capacity, mesh=mesh, presharded=presharded
        )
        return score((pixels.color, pixels.transmittance, pixels.depth), weight), (pixels, report)

    slope, (pixels, report) = jax.grad(loss, argnums=(0, 1), has_aux=True)(motion, rays)
    return pixels, report, slope


def main():
    assert len(jax.devices()) == 2
    scene, lines = resting(gaussians(COUNT, size=(0.1, 0.5))), shot(rays(RAYS))
    weight = weights(RAYS, np.float32)
    one, two = (pull(scene, lines, weight, ROOM, mesh(count)) for count in (1, 2))
    for pixels, report, _ in (one, two):
        assert pixels.color.shape == (RAYS, 3) and int(report.dropped) == int(report.skipped) == 0
        assert int(report.hits) == int(one[1].hits) > RAYS
    np.testing.assert_allclose(stacked(two[0]), stacked(one[0]), atol=SAME)
    for a, b in zip(jax.tree.leaves(two[2]), jax.tree.leaves(one[2]), strict=True):
        np.testing.assert_allclose(a, b, atol=SLOPE * max(np.abs(b).max(), 1e-30))
    assert all(np.any(x) for x in jax.tree.leaves(two[2][0].gaussians))
    # Whole blocks, each device's own: as many for each.
    own = jax.tree.map(lambda x: x[: 14 * 4], lines)
    alone, presharded = (pull(scene, own, weight[: 14 * 4], ROOM, mesh(n), n == 2) for n in (1, 2))
    np.testing.assert_allclose(stacked(presharded[0]), stacked(alone[0]), atol=SAME)
    for a, b in zip(jax.tree.leaves(presharded[2]), jax.tree.leaves(alone[2]), strict=True):
        np.testing.assert_allclose(a, b, atol=SLOPE * max(np.abs(b).max(), 1e-30))
    # Each device tells how much room it needs, and the largest counts.
    needed = np.asarray(two[1].needed)
    assert np.all(needed <= one[1].needed) and np.all(2 * needed >= one[1].needed)
    print("the same")


if __name__ == "__main__":
    main()
