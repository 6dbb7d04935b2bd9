"""How well candidates for the pruned scene match training pictures, and what each Gaussian adds."""

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
from gaussray.camera.corrections import apply_color_response
from gaussray.camera.rays import Rays
from gaussray.capture.spread import spread_indices
from gaussray.color import LEAST_MSE, psnr_from_mse, srgb_encode
from gaussray.reconstruct.data.batches import gather, tile_colors, tile_rays
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.optimize.loss import developed
from gaussray.reconstruct.simplify.candidate import Candidate, at_time
from gaussray.runtime.devices import from_primary
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0
from gaussray.tracer.measure import enlarged_capacity, measure
from gaussray.tracer.motion import Motion, key_times_across, still
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.traverse import Capacity


# Frames of a viewpoint, and tiles of each, whose mean colour is that of the viewpoint.
_MEAN_FRAMES, _MEAN_TILES = 8, 256
# Key states of one picture span at least this share of the scene's times.
_LEAST_SPAN = 1e-4


class TrainingViews(NamedTuple):
    """The training pictures with what was refined of their cameras.

    Args:
        footage: the pictures.
        camera: the cameras as refined, stacked.
        gain: the `color_response` of each frame as refined; None: light as it is.
    """

    footage: Footage
    camera: Camera
    gain: Float[Array, "frames 3 ..."] | None = None


class TileView(NamedTuple):
    """Tiles of training pictures at one time.

    Args:
        time: the time of the pictures, in the capture's unit.
        rays: chief rays of the pixels.
        truth: sRGB-encoded colours of the pixels, in [0, 1].
        weight: 0 where a picture is masked and where the lens forms no ray, else 1.
        gain: the `color_response` of each ray to linear light.
        mean: mean sRGB-encoded colour of the pictures of the ray's viewpoint.
    """

    time: Float[Array, ""]
    rays: Rays
    truth: Float[Array, "rays 3"]
    weight: Float[Array, " rays"]
    gain: Float[Array, "rays 3 ..."]
    mean: Float[Array, "rays 3"]

    def unmasked(self) -> "TileView":
        """The same tiles, of which every pixel with a ray counts."""
        rays = jnp.any(self.rays.direction != 0, axis=-1)
        return self._replace(weight=rays.astype(self.weight.dtype))


class ChosenTiles(NamedTuple):
    """Tiles to measure PSNR on, tiles to measure contributions on, and whether the latter are all
    tiles of all pictures."""

    measured: list[TileView]
    weighed: list[TileView]
    complete: bool


def tile_views(
    views: TrainingViews, *, tiles: int, instants: int, weigh: int, seed: int
) -> ChosenTiles:
    """Random tiles to measure PSNR on, and others, chosen independently, to measure contributions
    on.

    Neither are more than there are. The latter go through the tiles from time to time, so that
    together they cover the static scene if `weigh` allows.

    Args:
        views: the training pictures.
        tiles: ray bundles of the tiles of the first kind, at each time; of fewer times than
            `instants`, so many more that their number stays.
        instants: the largest number of times, which are evenly spread.
        weigh: ray bundles of the tiles of the second kind, about so many at all times together.
        seed: seed of both choices.
    """
    seen, gain = views.footage, views.gain
    tile_count, bundles = seen.pixel.shape[1], (seen.side // (seen.bundle or seen.side)) ** 2
    tiles, weigh = -(-tiles // bundles), -(-weigh // bundles)
    times, frames = np.unique(seen.times, return_counts=True)
    tiles = min(tiles, tile_count * int(frames.max()))
    chosen = spread_indices(len(times), instants)
    # More would be the same tiles again.
    most = -(-tile_count * int(frames.max()) // tiles)
    batches = min(-(-weigh // (tiles * len(chosen))), most)
    repeats = min(-(-instants // len(chosen)), most)
    gains = np.ones((len(seen.times), 3), seen.times.dtype) if gain is None else np.asarray(gain)
    means, measured, weighed, counted = _mean_colors(seen), [], [], 0
    for i, time in enumerate(times[chosen]):
        at_time = np.flatnonzero(seen.times == time)
        count = len(at_time) * tile_count
        order = np.random.default_rng(seed).permutation(count)
        passed = np.roll(order, -(i * count // len(chosen)))
        # Not [seed, i]: numpy's [seed, 0] is the stream of `seed`, and the loss would be measured
        # on the tiles that were weighed alone.
        drawn = np.random.default_rng([seed, 1 + i]).permutation(count)
        counted += min(batches * tiles, count)
        for part, cells, number in ((measured, drawn, repeats), (weighed, passed, batches)):
            for cell in np.resize(cells, number * tiles).reshape(-1, tiles):
                frame, tile = at_time[cell // tile_count], cell % tile_count
                known = gains[frame], means[frame]
                part.append(_tile_view(views, known, frame, tile, time))
    return ChosenTiles(measured, weighed, counted == tile_count * len(seen.times))


def _mean_colors(footage: Footage) -> Float[np.ndarray, "frames 3"]:
    """For every frame the mean sRGB-encoded colour of its viewpoint: of some tiles of some frames,
    evenly spread, without masked pixels."""
    owner = np.asarray(footage.viewpoints)
    means = np.zeros((len(owner), 3), np.float32)
    tiles = np.arange(0, footage.pixel.shape[1], -(-footage.pixel.shape[1] // _MEAN_TILES))
    for name in np.unique(owner):
        of_name = np.flatnonzero(owner == name)
        frames = of_name[:: -(-len(of_name) // _MEAN_FRAMES)]
        pixel = footage.pixel[frames[:, None], tiles].reshape(-1, 3)
        visible = footage.visible(frames[:, None], tiles)
        if visible is not None:
            pixel = pixel[visible.reshape(-1)]
        if len(pixel):
            means[of_name] = pixel.mean(axis=0, dtype=np.float64) / footage.scale
    return means


def one_color_psnr(views: Sequence[TileView]) -> float:
    """PSNR in dB of pictures that show nothing but the mean colour of their viewpoint, on these
    tiles."""
    error = [np.asarray(v.weight[:, None] * (v.mean - v.truth) ** 2) for v in views]
    square = [np.sum(x, dtype=np.float64) for x in error]
    weight = 3 * float(np.sum([np.sum(view.weight) for view in views]))
    return psnr_from_mse(float(np.sum(square)) / max(weight, 1.0), least=LEAST_MSE)


def _tile_view(views: TrainingViews, known, frame, tile, time) -> TileView:
    """Tiles of frames at a time; `known` are the gain and the mean colour of each frame."""
    seen = views.footage
    batch = jax.tree.map(lambda x: x[0], gather(seen, frame[None], tile[None], time[None]))
    truth, weight = tile_colors(batch)
    rays = _chief_rays(views.camera, batch.frame, batch.tile, side=seen.side, bundle=seen.bundle)
    weight = weight * jnp.any(rays.direction != 0, axis=-1)
    gain, mean = (jnp.repeat(jnp.asarray(x), seen.side**2, axis=0) for x in known)
    return TileView(batch.time, rays, truth, weight, gain, mean)


@eqx.filter_jit
def _chief_rays(views: Camera, frame: Array, tile: Array, *, side: int, bundle: int | None) -> Rays:
    camera = jax.tree.map(lambda x: x[frame], views)
    rays = tile_rays(camera, tile, jnp.full((1, 5), 0.5), side=side, bundle=bundle)
    return jax.tree.map(lambda x: x[0], rays)


class Tracing(eqx.Module):
    """How candidates are traced.

    Args:
        options: options of the tracer.
        mesh: the devices that share the rays.
        keys: the number of key states of the scene across the times of one picture; 1: all its rays
            share one time.
    """

    options: TraceOptions
    mesh: Mesh = eqx.field(static=True)
    keys: int = eqx.field(static=True, default=1)


# A program returns a value, the sizes of the tracer's lists, and how many entries were dropped.
_Program = Callable[[Candidate, TileView, Tracing, Capacity], tuple[Array, Array, Array]]


class CandidateMeter:
    """Measures candidates on the same tiles, in programs that are compiled once.

    Args:
        views: the tiles to measure PSNR on.
        tracing: how candidates are traced.
    """

    def __init__(self, views: Sequence[TileView], tracing: Tracing):
        self.views, self.tracing = views, tracing
        self.capacity: Capacity | None = None
        self.weight = 3 * float(np.sum([np.sum(view.weight) for view in views]))
        # Whether masks hide any pixels of the tiles.
        self.masked = any(np.any(view.unmasked().weight != view.weight) for view in views)

    def psnr(self, candidate: Candidate, *, least: float = -math.inf) -> float:
        """PSNR of sRGB-encoded colours, in dB, on the meter's tiles.

        Args:
            candidate: what is measured.
            least: in dB. As soon as the PSNR is sure to be below it, the result is -inf, which
                saves the rest of the tiles.
        """
        square, most = 0.0, self.weight * 10 ** (-least / 10)
        for view in self.views:
            square += float(from_primary(self._run(_error, candidate, view)))
            if square > most:
                return -math.inf
        return psnr_from_mse(square / self.weight, least=LEAST_MSE)

    def weights(
        self, candidate: Candidate, views: Sequence[TileView]
    ) -> Float[np.ndarray, " gaussians"]:
        """The sum of the blending weights of every Gaussian in some tiles; static ones first.

        Args:
            candidate: the candidate whose Gaussians are measured.
            views: the tiles to measure on, instead of those of the meter; at least one.
        """
        return from_primary(
            np.sum([self._run(_weights, candidate, view) for view in views], axis=0)
        )

    def _run(self, program: _Program, candidate: Candidate, view: TileView) -> np.ndarray:
        tracing = self.tracing
        if self.capacity is None:
            motion = _motion(candidate, view, keys=tracing.keys)
            self.capacity = measure(motion, view.rays, options=tracing.options)
        while True:
            value, needed, dropped = program(candidate, view, tracing, self.capacity)
            if not int(dropped):
                return np.asarray(value, np.float64)
            wanted = [int(n) for n in needed]
            self.capacity = enlarged_capacity(self.capacity, wanted)


@eqx.filter_jit
def _motion(candidate: Candidate, view: TileView, *, keys: int) -> Motion:
    """What a candidate shows across the times of its rays."""
    limits = candidate.scene.time_range
    if keys == 1:
        return still(at_time(candidate, view.time), candidate.scene.transient, limits)
    first, last = jnp.min(view.rays.time), jnp.max(view.rays.time)
    time = key_times_across(first, last, keys, least=_LEAST_SPAN * (limits[1] - limits[0]))
    state = jax.vmap(lambda t: at_time(candidate, t))(time)
    opacity, harmonics = state.opacity[keys // 2], state.harmonics[keys // 2]
    moved = Gaussians(state.mean, state.quat, state.scale, opacity, harmonics, state.tint)
    transient = candidate.scene.transient
    return Motion(time, moved, None, transient, None if transient is None else limits)


@eqx.filter_jit
def _error(
    candidate: Candidate, view: TileView, tracing: Tracing, capacity: Capacity
) -> tuple[Array, Array, Array]:
    """Sum of squared errors, list sizes and how many entries were dropped."""
    motion = _motion(candidate, view, keys=tracing.keys)
    pixels, report = trace_sharded(
        motion, view.rays, options=tracing.options, capacity=capacity, mesh=tracing.mesh
    )
    error = (
        developed(srgb_encode(apply_color_response(view.gain, pixels.color)), view.truth)
        - view.truth
    )
    return jnp.sum(view.weight[:, None] * error * error), report.needed, report.dropped


@eqx.filter_jit
def _weights(
    candidate: Candidate, view: TileView, tracing: Tracing, capacity: Capacity
) -> tuple[Array, Array, Array]:
    """Sum of every Gaussian's blending weights, list sizes and how many entries were dropped.

    A pixel is sum_i w_i c_i, so the sum of the pixels has the slope sum w_i along the colour c_i of
    one Gaussian; that colour is 1/2 + C0 x of its constant harmonic x.
    """
    motion = _motion(candidate, view, keys=tracing.keys)
    every = motion.gaussians

    def light(x: Array) -> tuple[Array, tuple[Array, Array]]:
        harmonics = jnp.broadcast_to(x[:, None, None], (len(x), 1, 3))
        plain = Gaussians(every.mean, every.quat, every.scale, every.opacity, harmonics)
        pixels, report = trace_sharded(
            replace(motion, gaussians=plain),
            view.rays,
            options=tracing.options,
            capacity=capacity,
            mesh=tracing.mesh,
        )
        return jnp.sum(view.weight * pixels.color[:, 0]), (report.needed, report.dropped)

    # The slope is the same wherever colours are not clamped; zeros would be folded at compile time.
    slope, report = jax.grad(light, has_aux=True)(every.opacity)
    return slope / C0, *report
