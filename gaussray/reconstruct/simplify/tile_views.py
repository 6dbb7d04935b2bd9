"""Tiles of training pictures to measure candidates for the pruned scene on."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera
from gaussray.camera.rays import Rays
from gaussray.capture.spread import spread_indices
from gaussray.color import LEAST_MSE, psnr_from_mse
from gaussray.reconstruct.data.batches import Batch, gather, tile_colors, tile_rays
from gaussray.reconstruct.data.pictures import Footage


# Frames of a viewpoint, and tiles of each, whose mean colour is that of the viewpoint.
_MEAN_FRAMES, _MEAN_TILES = 8, 256


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
        frames_of_time = np.flatnonzero(seen.times == time)
        count = len(frames_of_time) * tile_count
        order = np.random.default_rng(seed).permutation(count)
        passed = np.roll(order, -(i * count // len(chosen)))
        # Not [seed, i]: numpy's [seed, 0] is the stream of `seed`, and the loss would be measured
        # on the tiles that were weighed alone.
        drawn = np.random.default_rng([seed, 1 + i]).permutation(count)
        counted += min(batches * tiles, count)
        for part, cells, number in ((measured, drawn, repeats), (weighed, passed, batches)):
            for cell in np.resize(cells, number * tiles).reshape(-1, tiles):
                frame, tile = frames_of_time[cell // tile_count], cell % tile_count
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
    known = [(np.asarray(v.weight), np.asarray(v.mean), np.asarray(v.truth)) for v in views]
    square = [np.sum(w[:, None] * (a - b) ** 2, dtype=np.float64) for w, a, b in known]
    weight = 3 * float(np.sum([np.sum(view.weight) for view in views]))
    return psnr_from_mse(float(np.sum(square)) / max(weight, 1.0), least=LEAST_MSE)


def _tile_view(views: TrainingViews, known, frame, tile, time) -> TileView:
    """Tiles of frames at a time; `known` are the gain and the mean colour of each frame."""
    seen = views.footage
    batch = gather(seen, frame[None], tile[None], time[None])
    return _seen_tiles(views.camera, batch, known, side=seen.side, bundle=seen.bundle)


# One program: each operation by itself would be compiled as well.
@eqx.filter_jit
def _seen_tiles(
    cameras: Camera, batches: Batch, known, *, side: int, bundle: int | None
) -> TileView:
    batch = jax.tree.map(lambda x: x[0], batches)
    truth, weight = tile_colors(batch)
    camera = jax.tree.map(lambda x: x[batch.frame], cameras)
    rays = tile_rays(camera, batch.tile, jnp.full((1, 5), 0.5), side=side, bundle=bundle)
    rays = jax.tree.map(lambda x: x[0], rays)
    weight = weight * jnp.any(rays.direction != 0, axis=-1)
    gain, mean = (jnp.repeat(jnp.asarray(x), side**2, axis=0) for x in known)
    return TileView(batch.time, rays, truth, weight, gain, mean)
