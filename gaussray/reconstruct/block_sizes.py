"""The static sizes that steps are compiled for."""

from functools import partial

import equinox as eqx
from jax.sharding import Mesh

from gaussray.tracer.measure import HEADROOM, enlarged_capacity
from gaussray.tracer.traverse import Capacity, enlarged_size


class BlockSizes(eqx.Module):
    """The static sizes that a block of steps is compiled for.

    Args:
        capacity: sizes of the tracer's lists.
        mesh: the devices that share the rays.
        keys: the number of key states of the scene across a step; 1: all its rays share one time.
        seen: places for the persistent and the transient Gaussians that the tiles of a step may
            meet (`seen_part`); None: all Gaussians are traced.
    """

    capacity: Capacity
    mesh: Mesh = eqx.field(static=True)
    keys: int = eqx.field(static=True, default=1)
    seen: tuple[int, int] | None = eqx.field(static=True, default=None)

    def enlarged(self, needed) -> "BlockSizes":
        """Sizes for a block whose lists needed this much room."""
        lists, seen = [int(n) for n in needed], self.seen
        if seen is not None:
            grown = partial(enlarged_size, headroom=HEADROOM, near=1.0)
            seen = grown(seen[0], lists[-2]), grown(seen[1], lists[-1])
            lists = lists[:-2]
        capacity = enlarged_capacity(self.capacity, lists)
        return BlockSizes(capacity, self.mesh, self.keys, seen)
