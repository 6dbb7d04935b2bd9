"""How well drafts of a scene match the training pictures, and which Gaussians do it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.rays import Rays
from gaussray.color import srgb_encode
from gaussray.reconstruct.data.batches import gather, tile_colors, tile_rays
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.log import decibel
from gaussray.reconstruct.optimize.loss import developed
from gaussray.reconstruct.simplify.draft import Draft, at_time
from gaussray.runtime.devices import agreed
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0
from gaussray.tracer.motion import Motion, still
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.trace import TraceOptions, enlarge, measure
from gaussray.tracer.traverse import Capacity


class Look(NamedTuple):
    """Some tiles of training pictures at one instant: chief rays, encoded colours, the weight of
    each ray (0 where a picture is masked, and where the lens forms no ray), and what linear light
    is multiplied by."""

    time: Float[Array, ""]
    rays: Rays
    truth: Float[Array, "rays 3"]
    weight: Float[Array, " rays"]
    gain: Float[Array, "rays 3"]


def looks(
    seen: Footage,
    views: Camera,
    gain: Float[Array, "frames 3"] | None = None,
    *,
    tiles: int,
    instants: int,
    weigh: int,
    seed: int,
) -> tuple[list[Look], list[Look]]:
    """Looks at random tiles, as many as hold `tiles` ray bundles (at most all) at each of so many
    instants, evenly spread; and further ones at about `weigh` bundles in all. `views` and `gain`
    are the frames' cameras and exposures, as refined.

    The further ones go through all tiles from instant to instant, so that together they see all of
    what stands still if their number allows.
    """
    each, bundles = seen.pixel.shape[1], (seen.side // (seen.bundle or seen.side)) ** 2
    tiles, weigh = -(-tiles // bundles), -(-weigh // bundles)
    times, frames = np.unique(seen.times, return_counts=True)
    tiles = min(tiles, each * int(frames.max()))
    chosen = np.unique(np.linspace(0, len(times) - 1, instants).round().astype(int))
    batches = -(-weigh // (tiles * len(chosen)))
    light = np.ones((len(seen.times), 3), seen.times.dtype) if gain is None else np.asarray(gain)
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
                found.append(_look(seen, views, light[frame], frame, tile, time))
    return some, further


def _look(seen: Footage, views: Camera, gain, frame, tile, time) -> Look:
    batch = jax.tree.map(lambda x: x[0], gather(seen, frame[None], tile[None], time[None]))
    truth, weight = tile_colors(batch)
    rays = _chief_rays(views, batch.frame, batch.tile, side=seen.side, bundle=seen.bundle)
    weight = weight * jnp.any(rays.direction != 0, axis=-1)
    return Look(
        batch.time, rays, truth, weight, jnp.repeat(jnp.asarray(gain), seen.side**2, axis=0)
    )


@eqx.filter_jit
def _chief_rays(views: Camera, frame: Array, tile: Array, *, side: int, bundle: int | None) -> Rays:
    camera = jax.tree.map(lambda x: x[frame], views)
    rays = tile_rays(camera, tile, jnp.full((1, 5), 0.5), side=side, bundle=bundle)
    return jax.tree.map(lambda x: x[0], rays)


class Gauge:
    """Measures drafts of one scene on the same rays, in programs that are compiled once.

    `keys` states of the scene span the times of a look's rays; one will do where they share it.
    """

    def __init__(self, looks: Sequence[Look], *, trace: TraceOptions, mesh: Mesh, keys: int = 1):
        self.looks, self.trace, self.mesh, self.keys = looks, trace, mesh, keys
        self.capacity: Capacity | None = None
        self.weight = 3 * float(np.sum([np.sum(look.weight) for look in looks]))

    def psnr(self, draft: Draft, *, least: float = -math.inf) -> float:
        """PSNR on the rays, encoded colours, in dB; -inf as soon as it is sure to be below `least`,
        which saves the rest of the looks."""
        square, most = 0.0, self.weight * 10 ** (-least / 10)
        for look in self.looks:
            square += float(agreed(self._run(_error, draft, look)))
            if square > most:
                return -math.inf
        return decibel(square / self.weight)

    def weights(self, draft: Draft, looks: Sequence[Look]) -> Float[np.ndarray, " gaussians"]:
        """What every Gaussian adds to the rays of these looks: the sum of its blending weights."""
        return agreed(np.sum([self._run(_weights, draft, look) for look in looks], axis=0))

    def _run(self, program: Callable, draft: Draft, look: Look) -> np.ndarray:
        if self.capacity is None:
            motion = _motion(draft, look, keys=self.keys)
            self.capacity = measure(motion, look.rays, options=self.trace, headroom=1.5)
        while True:
            options = {"trace": self.trace, "capacity": self.capacity, "mesh": self.mesh}
            value, needed, dropped = program(draft, look, **options, keys=self.keys)
            if not int(dropped):
                return np.asarray(value, np.float64)
            wanted = [int(n) for n in needed]
            self.capacity = enlarge(self.capacity, wanted, headroom=1.5)


@eqx.filter_jit
def _motion(draft: Draft, look: Look, *, keys: int) -> Motion:
    """What a draft shows across the times of a look."""
    limits = draft.scene.time_range
    if keys == 1:
        return still(at_time(draft, look.time), draft.scene.transient, limits)
    time = jnp.linspace(jnp.min(look.rays.time), jnp.max(look.rays.time), keys)
    state = jax.vmap(lambda t: at_time(draft, t))(time)
    opacity, harmonics = state.opacity[keys // 2], state.harmonics[keys // 2]
    moved = Gaussians(state.mean, state.quat, state.scale, opacity, harmonics, state.tint)
    transient = draft.scene.transient
    return Motion(time, moved, None, transient, None if transient is None else limits)


@eqx.filter_jit
def _error(
    draft: Draft, look: Look, *, trace: TraceOptions, capacity: Capacity, mesh: Mesh, keys: int
) -> tuple[Array, Array, Array]:
    """Sum of squared errors, list sizes and how many entries were dropped."""
    motion = _motion(draft, look, keys=keys)
    pixels, report = trace_sharded(motion, look.rays, options=trace, capacity=capacity, mesh=mesh)
    error = developed(srgb_encode(look.gain * pixels.color), look.truth) - look.truth
    return jnp.sum(look.weight[:, None] * error * error), report.needed, report.dropped


@eqx.filter_jit
def _weights(
    draft: Draft, look: Look, *, trace: TraceOptions, capacity: Capacity, mesh: Mesh, keys: int
) -> tuple[Array, Array, Array]:
    """Sum of every Gaussian's blending weights, list sizes and how many entries were dropped.

    A pixel is sum_i w_i c_i, so the sum of the pixels has the slope sum w_i along the colour c_i of
    one Gaussian; that colour is 1/2 + C0 x of its constant harmonic x.
    """
    motion = _motion(draft, look, keys=keys)
    every = motion.gaussians

    def light(x: Array) -> tuple[Array, tuple[Array, Array]]:
        harmonics = jnp.broadcast_to(x[:, None, None], (len(x), 1, 3))
        plain = Gaussians(every.mean, every.quat, every.scale, every.opacity, harmonics)
        painted = replace(motion, gaussians=plain)
        pixels, report = trace_sharded(
            painted, look.rays, options=trace, capacity=capacity, mesh=mesh
        )
        return jnp.sum(look.weight * pixels.color[:, 0]), (report.needed, report.dropped)

    # The slope is the same wherever colours are not clamped; zeros would be folded at compile time.
    slope, found = jax.grad(light, has_aux=True)(every.opacity)
    return slope / C0, *found
