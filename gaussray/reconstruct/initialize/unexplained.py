"""What moves in the pictures of cameras that move: what Gaussians that stand still do not show.

A camera that stands still has a temporal median. One that moves has none; instead, Gaussians that
stand still are fitted to its pictures first. They show what most pictures agree on, and what
differs from that moves. Where one picture alone shows it, it gets the distance of what stands
still beside it.
"""

import threading
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt16
from scipy.ndimage import uniform_filter

from gaussray.camera.camera import Camera
from gaussray.camera.rays import Rays
from gaussray.capture.temporal_median import AVERAGED, stands_out
from gaussray.color import srgb_encode
from gaussray.reconstruct.data.backdrop import BackdropColor, before_backdrop
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.still_cameras import camera_frames, without_specks
from gaussray.reconstruct.data.tiles import cut, tile_pixels
from gaussray.reconstruct.initialize.stereo.matching import reduction
from gaussray.reconstruct.initialize.stereo.neighbour_depth import points_beside
from gaussray.reconstruct.initialize.stereo.points import StereoPoints
from gaussray.reconstruct.initialize.stereo.views import StereoViews, rays, stereo_views, unpacked
from gaussray.scene.gaussians import Gaussians
from gaussray.tracer.bundle import fill_padding, morton_tiles
from gaussray.tracer.measure import enlarged_capacity, measure
from gaussray.tracer.motion import Motion, still as resting
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.trace import trace
from gaussray.tracer.traverse import Capacity


# Pixels of a picture that is rendered, at most.
_PIXELS_CPU, _PIXELS_GPU = 33_000, 250_000
# Opacity from which on a ray is taken to end at a surface.
_SOLID = 0.5


class _Compared(NamedTuple):
    """A frame beside what stands still: the reduced view, which of its pixels move, and distances
    to what stands still."""

    view: StereoViews
    moved: Bool[np.ndarray, "rows columns"]
    distance: Float[np.ndarray, "rows columns"]


class UnexplainedPixels:
    """Which pixels of a training frame differ from what Gaussians that stand still show.

    `counts` keeps the number of such pixels in every tile of the frames that were asked for.

    Args:
        footage: the training pictures.
        camera: their cameras, as refined so far.
        gain: the `color_response` of each frame to linear light; None: light as it is.
        still: the Gaussians that stand still.
        options: how to trace them.
        plain: sRGB-encoded colour of a backdrop behind them; None if there is none.
    """

    def __init__(
        self,
        footage: Footage,
        camera: Camera,
        gain: Float[Array, "frames 3 ..."] | None,
        still: Gaussians,
        options: TraceOptions,
        plain: BackdropColor | None = None,
    ):
        self._plain = plain
        self._footage, self._camera = footage, camera
        self._gain = None if gain is None else np.asarray(gain)
        self._motion, self._trace = resting(still), replace(options, levels=0)
        most = _PIXELS_CPU if jax.default_backend() == "cpu" else _PIXELS_GPU
        self._factor = reduction((footage.film.height, footage.film.width), most)
        self._capacity: Capacity | None = None
        self._last: tuple[int, _Compared] | None = None
        self._lock = threading.Lock()
        self.counts: dict[int, UInt16[np.ndarray, " tiles"]] = {}

    def __call__(self, frame: int) -> Bool[np.ndarray, "h w"]:
        """The mask of a frame."""
        footage = self._footage
        moved = _enlarged(
            self._compared(frame).moved, self._factor, (footage.film.height, footage.film.width)
        )
        visible = footage.masks(np.array([frame]))
        moved = moved if visible is None else moved & visible[0]
        pixels = tile_pixels(footage.film, footage.side, footage.bundle)
        self.counts[frame] = cut(moved, pixels).sum(axis=-1).astype(np.uint16)
        return moved

    def points(self, frame: int) -> StereoPoints:
        """Points of what moves in a frame, as far away as what stands still beside it."""
        return points_beside(*self._compared(frame))

    def _compared(self, frame: int) -> _Compared:
        """A frame beside what stands still; the last one asked for is not rendered again. One after
        another, for threads that ask for several."""
        with self._lock:
            return self._looked_at(frame)

    def _looked_at(self, frame: int) -> _Compared:
        if self._last is None or self._last[0] != frame:
            one = np.array([frame])
            camera = jax.tree.map(lambda x: x[one], self._camera)
            pictures, masks = self._footage.pictures(one), self._footage.masks(one)
            view = stereo_views(pictures, camera, masks, factor=self._factor)[0]
            shown, distance = self._rendered(view)
            if self._gain is not None:
                own = self._gain[frame]
                shown = shown * own if own.ndim == 1 else shown @ own.T
            channels, visible = jax.device_get(unpacked(view.pixel, jnp.float32))
            difference = np.stack(channels, axis=-1) - np.asarray(srgb_encode(shown))
            moved = without_specks(stands_out(uniform_filter(difference, AVERAGED, axes=(0, 1))))
            self._last = frame, _Compared(view, moved & visible, distance)
        return self._last[1]

    def tile_counts(self) -> UInt16[np.ndarray, "frames tiles"]:
        """Moving pixels of every frame and tile; frames that were not asked for have those of the
        nearest one in time that the same camera took."""
        footage = self._footage
        result = np.zeros(footage.pixel.shape[:2], np.uint16)
        for own, _ in camera_frames(footage):
            asked = np.array([frame for frame in own if int(frame) in self.counts], np.int64)
            if not len(asked):
                continue
            away = np.abs(footage.times[own][:, None] - footage.times[asked][None])
            nearest = asked[np.argmin(away, axis=1)]
            result[own] = np.stack([self.counts[int(frame)] for frame in nearest])
        return result

    def _rendered(
        self, view: StereoViews
    ) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
        """Linear light of what stands still, as a view shows it, and its distance; infinite where
        most of the light passes."""
        seen = _bundled_rays(view, self._trace.bundle)
        if self._capacity is None:
            self._capacity = measure(self._motion, seen, options=self._trace)
        while True:
            light, distance, needed, dropped = _light(
                self._motion,
                seen,
                options=self._trace,
                capacity=self._capacity,
                plain=self._plain,
            )
            if not int(dropped):
                break
            sizes = [int(n) for n in needed]
            self._capacity = enlarged_capacity(self._capacity, sizes)
        order = _order(view.size, self._trace.bundle)
        picture = np.empty((order.max() + 1, 4), np.float32)
        both = np.concatenate([light, np.asarray(distance)[:, None]], axis=1)
        picture[order[order >= 0]] = both[order >= 0]
        picture = picture.reshape(*view.size, 4)
        return picture[..., :3], picture[..., 3]


def _order(size: tuple[int, int], bundle: int) -> Int[np.ndarray, " slots"]:
    """The pixel of every ray, -1 for padding."""
    return morton_tiles(size[1], size[0], bundle, 0)


@eqx.filter_jit
def _bundled_rays(view: StereoViews, bundle: int) -> Rays:
    """The rays of a view in the order in which they are traced."""
    direction = rays(view.lens, view.world_from_camera, view.size, view.factor)
    direction = direction.reshape(3, -1).T[fill_padding(_order(view.size, bundle))]
    origin = jnp.broadcast_to(view.origin, direction.shape)
    return Rays(origin, direction, jnp.zeros(len(direction), direction.dtype))


@eqx.filter_jit
def _light(
    motion: Motion,
    seen: Rays,
    *,
    options: TraceOptions,
    capacity: Capacity,
    plain: BackdropColor | None,
) -> tuple[Float[Array, "slots 3"], Float[Array, " slots"], Int[Array, " sizes"], Int[Array, ""]]:
    """Linear light of rays, distances, list sizes, and how many entries were dropped."""
    pixels, report = trace(motion, seen, options=options, capacity=capacity)
    light, opacity = pixels.color, 1 - pixels.transmittance
    solid = opacity > _SOLID
    distance = jnp.where(solid, pixels.depth / jnp.where(solid, opacity, 1), jnp.inf)
    if plain is not None:
        light = before_backdrop(light, pixels.transmittance, plain)
    return light, distance, report.needed, report.dropped


def _enlarged(
    moved: Bool[np.ndarray, "rows columns"], factor: int, size: tuple[int, int]
) -> Bool[np.ndarray, "h w"]:
    """A mask of a reduced picture at the size of the whole one."""
    large = moved.repeat(factor, axis=0).repeat(factor, axis=1)
    lack = [(0, n - m) for n, m in zip(size, large.shape, strict=True)]
    return np.pad(large, lack, mode="edge")
