"""Masks of the pixels that an evaluation scores: visible, moving, static."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float16, UInt8

from gaussray.camera.camera import Camera
from gaussray.camera.film import pixel_grid
from gaussray.capture.capture import View, viewpoints
from gaussray.capture.frames import read_with_mask
from gaussray.capture.spread import evenly_spread
from gaussray.capture.temporal_median import differs, temporal_median


# Pictures of a viewpoint of which the median is taken, at most: those of a long video take
# gigabytes.
_MOST = 100
# Bytes of pictures of several viewpoints that are held at once, about.
_BYTES = 1e9


def levels_and_mask(
    view: View,
) -> tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"] | None]:
    """The picture of a view in 8-bit sRGB levels, and its pixels that count (None: all)."""
    picture, shown = read_with_mask(view)
    if picture.dtype != np.uint8:
        picture = np.clip(np.round(picture * 255), 0, 255).astype(np.uint8)
    return picture, shown


def visible_mask(camera: Camera) -> Bool[np.ndarray, "h w"] | None:
    """Pixels inside the lens's field of view, less a rim of one pixel; None if all are inside."""
    grid = pixel_grid(camera.film)
    flat = grid.reshape(-1, 2).astype(camera.time.dtype) + 0.5
    has_ray = np.asarray(_sees(camera, flat)).reshape(grid.shape[:2])
    if has_ray.all():
        return None
    padded = np.pad(has_ray, 1, constant_values=True)
    inner = has_ray.copy()
    for dy in range(3):
        for dx in range(3):
            inner &= padded[dy : dy + has_ray.shape[0], dx : dx + has_ray.shape[1]]
    return inner


@eqx.filter_jit
def _sees(camera: Camera, pixel: Array) -> Array:
    return jax.vmap(camera.lens.sees)(pixel)


def circle_mask(shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """The centred disc in which the fisheye benchmark scores: 409.6 of 512 pixels across."""
    y, x = (np.arange(n) + 0.5 - n / 2 for n in shape)
    return np.hypot(x, y[:, None]) < 0.4 * min(shape)


class MotionMasks:
    """Which pixels move in the pictures of cameras that stand still: those that differ from the
    temporal median of their viewpoint. Pixels that a mask hides tell nothing.

    Medians are found when they are first asked for; of more than a hundred pictures of a viewpoint,
    a hundred tell that are evenly spread. Pictures of a moving camera have no common viewpoint, so
    nothing is said of them.

    Args:
        views: all pictures of the capture, also those that are not scored.
    """

    def __init__(self, views: Sequence[View]):
        self._group: dict[Path, int] = {}
        self._views: dict[int, list[View]] = {}
        self._places: dict[str, set[int]] = {}
        for viewpoint, view in zip(viewpoints(views), views, strict=True):
            self._group[view.image] = viewpoint
            self._views.setdefault(viewpoint, []).append(view)
            self._places.setdefault(view.camera_name, set()).add(viewpoint)
        self._found: dict[int, _Still] = {}

    def find(self, views: Sequence[View], threads: ThreadPoolExecutor) -> None:
        """Find the medians of the viewpoints of some views, several at a time.

        Args:
            views: some of the views.
            threads: look at a viewpoint each.
        """
        places = dict.fromkeys(self._group[view.image] for view in views)
        missing = [p for p in places if p not in self._found and len(self._views[p]) > 1]
        first = self._views[missing[0]] if missing else []
        size = sum(3 * view.width * view.height for view in first[:_MOST])
        step = int(max(_BYTES // max(size, 1), 1))
        for begin in range(0, len(missing), step):
            batch = missing[begin : begin + step]
            self._found |= zip(batch, threads.map(self._median_of, batch), strict=True)

    def moving(
        self, view: View, picture: UInt8[np.ndarray, "h w 3"]
    ) -> Bool[np.ndarray, "h w"] | None:
        """The pixels of a picture that move; None if it is the only one of its viewpoint.

        Args:
            view: one of the views.
            picture: its picture (`levels_and_mask`).
        """
        still = self._still(view)
        return None if still is None else differs(picture, still.median, 255)

    def static(self, view: View) -> Bool[np.ndarray, "h w"] | None:
        """The pixels of a camera in which nothing ever moves; None if it has several viewpoints or
        a single picture.

        Args:
            view: one of the camera's views.
        """
        still = self._still(view) if len(self._places[view.camera_name]) == 1 else None
        return None if still is None else still.static

    def _still(self, view: View) -> "_Still | None":
        viewpoint = self._group[view.image]
        if viewpoint not in self._found and len(self._views[viewpoint]) > 1:
            self._found[viewpoint] = self._median_of(viewpoint)
        return self._found.get(viewpoint)

    def _median_of(self, viewpoint: int) -> "_Still":
        group = self._views[viewpoint]
        chosen = evenly_spread(group, _MOST)
        read = list(map(levels_and_mask, chosen))
        pictures = np.stack([levels for levels, _ in read])
        shown = _stacked([mask for _, mask in read], pictures.shape[1:3])
        del read  # the pictures, a second time
        # Medians of levels are multiples of one half; NaN, where nothing is shown, differs from
        # nothing.
        median = temporal_median(pictures, shown).astype(np.float16)
        # What no picture exceeds, the lowest and the highest levels of all do not.
        low, high = _ends(pictures, shown)
        return _Still(median, ~(differs(low, median, 255) | differs(high, median, 255)))


def _stacked(
    masks: Sequence[Bool[np.ndarray, "h w"] | None], shape: tuple[int, ...]
) -> Bool[np.ndarray, "n h w"] | None:
    """Masks of pictures of one size; None if none has one."""
    if all(mask is None for mask in masks):
        return None
    return np.stack([np.ones(shape, bool) if mask is None else mask for mask in masks])


def _ends(
    pictures: UInt8[np.ndarray, "n h w 3"], shown: Bool[np.ndarray, "n h w"] | None
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """The lowest and the highest level of each pixel among those that are shown; 255 and 0 where
    none is."""
    if shown is None:
        return pictures.min(axis=0), pictures.max(axis=0)
    # Picture by picture, without a copy of all; several times as fast as `where=`.
    low, high = np.full_like(pictures[0], 255), np.zeros_like(pictures[0])
    for picture, mask in zip(pictures, shown, strict=True):
        known = np.repeat(255 * mask.astype(np.uint8), 3, axis=1).reshape(picture.shape)
        np.minimum(low, picture | ~known, out=low)
        np.maximum(high, picture & known, out=high)
    return low, high


class _Still(NamedTuple):
    """What a viewpoint shows most of the time, in 8-bit levels, and where it shows nothing else."""

    median: Float16[np.ndarray, "h w 3"]
    static: Bool[np.ndarray, "h w"]
