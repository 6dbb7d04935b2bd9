"""How well drafts of a scene match the training pictures, and which Gaussians do it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float

from gaussray.camera.rays import Rays
from gaussray.capture.batches import Footage, tile_grid, tile_rays
from gaussray.color import srgb_encode
from gaussray.devices import agreed
from gaussray.fit.draft import Draft, at_time
from gaussray.fit.journal import decibel
from gaussray.fit.loss import developed
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0
from gaussray.tracer.motion import still
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.trace import TraceOptions, enlarge, measure
from gaussray.tracer.traverse import Capacity


class Look(NamedTuple):
    """Some tiles of training pictures at one time: rays, encoded colours, and the weight of each
    ray (0 where a picture is masked)."""

    time: Float[Array, ""]
    rays: Rays
    truth: Float[Array, "rays 3"]
    weight: Float[Array, " rays"]


def looks(
    seen: Footage, side: int, *, tiles: int, instants: int, weigh: int, seed: int
) -> tuple[list[Look], list[Look]]:
    """Looks at random tiles, `tiles` (at most all) at each of so many instants, evenly spread; and
    further ones at about `weigh` tiles in all.

    The further ones go through all tiles from instant to instant, so that together they see all of
    what stands still if their number allows.
    """
    columns, rows = tile_grid(seen, side)
    each = columns * rows
    times, frames = np.unique(seen.times, return_counts=True)
    tiles = min(tiles, each * int(frames.max()))
    chosen = np.unique(np.linspace(0, len(times) - 1, instants).round().astype(int))
    batches = -(-weigh // (tiles * len(chosen)))
    some, further = [], []
    for i, time in enumerate(times[chosen]):
        own = np.flatnonzero(seen.times == time)
        count = len(own) * each
        order = np.random.default_rng(seed).permutation(count)
        passed = np.roll(order, -(i * count // len(chosen)))
        drawn = np.random.default_rng([seed, i]).permutation(count)
        for found, cells, size in ((some, drawn, tiles), (further, passed, batches * tiles)):
            for cell in np.resize(cells, size).reshape(-1, tiles):
                frame, tile = own[cell // each], cell % each
                parts = _tile_rays(seen, jnp.asarray(frame), jnp.asarray(tile), side=side)
                found.append(Look(jnp.asarray(time, parts[1].dtype), *parts))
    return some, further


# Compiled once for all looks.
_tile_rays = eqx.filter_jit(tile_rays)


class Gauge:
    """Measures drafts of one scene on the same rays, in programs that are compiled once."""

    def __init__(self, looks: Sequence[Look], *, trace: TraceOptions, mesh: Mesh):
        self.looks, self.trace, self.mesh = looks, trace, mesh
        self.capacity: Capacity | None = None

    def psnr(self, draft: Draft) -> float:
        """PSNR on the rays, encoded colours, in dB."""
        square, weight = np.sum([self._run(_error, draft, x) for x in self.looks], axis=0)
        return decibel(agreed(jnp.asarray(square / weight)))

    def weights(self, draft: Draft, looks: Sequence[Look]) -> Float[np.ndarray, " gaussians"]:
        """What every Gaussian adds to the rays of these looks: the sum of its blending weights."""
        return agreed(np.sum([self._run(_weights, draft, look) for look in looks], axis=0))

    def _run(self, program: Callable, draft: Draft, look: Look) -> np.ndarray:
        if self.capacity is None:
            motion = still(_at_time(draft, look.time))
            self.capacity = measure(motion, look.rays, options=self.trace, headroom=1.5)
        while True:
            options = {"trace": self.trace, "capacity": self.capacity, "mesh": self.mesh}
            value, needed, dropped = program(draft, look, **options)
            if not int(dropped):
                return np.asarray(value, np.float64)
            wanted = [int(n) for n in needed]
            self.capacity = enlarge(self.capacity, wanted, headroom=1.5)


# Everything a draft shows at one time, for all who measure alike.
_at_time = eqx.filter_jit(at_time)


@eqx.filter_jit
def _error(
    draft: Draft, look: Look, *, trace: TraceOptions, capacity: Capacity, mesh: Mesh
) -> tuple[Array, Array, Array]:
    """Sum of squared errors and of their weights, list sizes and how many entries were dropped."""
    motion = still(at_time(draft, look.time))
    pixels, report = trace_sharded(motion, look.rays, options=trace, capacity=capacity, mesh=mesh)
    error = developed(srgb_encode(pixels.color), look.truth) - look.truth
    square = jnp.sum(look.weight[:, None] * error * error)
    return jnp.stack([square, 3 * jnp.sum(look.weight)]), report.needed, report.dropped


@eqx.filter_jit
def _weights(
    draft: Draft, look: Look, *, trace: TraceOptions, capacity: Capacity, mesh: Mesh
) -> tuple[Array, Array, Array]:
    """Sum of every Gaussian's blending weights, list sizes and how many entries were dropped.

    A pixel is sum_i w_i c_i, so the sum of the pixels has the slope sum w_i along the colour c_i of
    one Gaussian; that colour is 1/2 + C0 x of its constant harmonic x.
    """
    every = at_time(draft, look.time)

    def light(x: Array) -> tuple[Array, tuple[Array, Array]]:
        harmonics = jnp.broadcast_to(x[:, None, None], (len(x), 1, 3))
        parts = every.mean, every.quat, every.scale, every.opacity, harmonics
        pixels, report = trace_sharded(
            still(Gaussians(*parts)), look.rays, options=trace, capacity=capacity, mesh=mesh
        )
        return jnp.sum(look.weight * pixels.color[:, 0]), (report.needed, report.dropped)

    # The slope is the same wherever colours are not clamped; zeros would be folded at compile time.
    slope, found = jax.grad(light, has_aux=True)(every.opacity)
    return slope / C0, *found
