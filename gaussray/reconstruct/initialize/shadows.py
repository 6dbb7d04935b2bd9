"""Shadows and reflected light that pass over what stands still, measured in the pictures."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import uniform_filter
from scipy.sparse import csr_array

from gaussray.capture.temporal_median import differs
from gaussray.color import srgb_decode
from gaussray.reconstruct.data.motion_mask import projected
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.still_cameras import FEWEST_FRAMES, camera_frames, median_picture
from gaussray.runtime.progress import ProgressReport, no_report
from gaussray.scene.shading import Shading


# Cameras that must see a point at a time for their median to count.
_CAMERAS = 3
# Pictures that are looked at, and times, at most.
_PICTURES, _TIMES = 1200, 60
# Pixels along the shorter side of the pictures that are compared, and the share of that side over
# which colours are averaged.
_SIDE, _AVERAGED = 192, 0.04
# A pixel tells if so much of what is averaged around it does not move, and is brighter than this,
# in linear light.
_STANDS_STILL, _DARK = 0.7, 0.01
# Differences of logarithms of linear light: those of the channels below which a pixel keeps its
# hue, and the deepest shadow in which it may. Darker channels count as faint ones.
_HUE, _DEEPEST, _FAINT = 0.12, 1.5, 1e-3
# Points in a cell of the grid on a surface, roughly, and cells along the longest side.
_POINTS_OF_CELL, _FEWEST_CELLS, _MOST_CELLS = 4, 4, 48
# Share of the points, on each side of each axis, that are strays beyond the grid.
_STRAYS = 0.005
# Weight of the points around a vertex below which nothing is known there.
_LEAST_WEIGHT = 0.05
# Standard errors of the median below which a change is taken for noise.
_NOISE = 2.0
# Standard deviation of normal numbers for their median absolute deviation.
_NORMAL = 1.4826


def measured_shading(
    footage: Footage,
    position: Float[np.ndarray, "points 3"],
    *,
    report: ProgressReport = no_report,
) -> Shading | None:
    """How shadows and reflected light pass over points that stand still.

    At each time each camera that stands still compares its picture with its temporal median, where
    nothing moves. The logarithm of the factor of a point is the median over the cameras, which
    leaves out what hides the point in some of them and what mirrors show to one of them, less what
    their disagreement explains. Vertices of the grid get the means of the points around them.

    Args:
        footage: the training pictures, evened out.
        position: points on surfaces, in scene units.
        report: called after each time.

    Returns:
        None where too few cameras stand still, or nothing passes.
    """
    cameras = [own for own, still in camera_frames(footage) if still and len(own) >= FEWEST_FRAMES]
    if len(cameras) < _CAMERAS or not len(position):
        return None
    every = np.unique(footage.times[np.concatenate(cameras)])
    most = max(min(len(every), _TIMES, _PICTURES // len(cameras)), 2)
    times = every[np.linspace(0, len(every) - 1, most).round().astype(int)]
    compared = [_Comparison(footage, own, position) for own in cameras]
    change = np.full((len(times), len(position)), np.nan, np.float32)
    for row, time in enumerate(times.tolist()):
        change[row] = _agreed([camera.log_gain(time) for camera in compared])
        report(row + 1, len(times))
    if not np.any(np.nan_to_num(change)):
        return None
    lower, upper = np.quantile(position, (_STRAYS, 1 - _STRAYS), axis=0)
    # A flat box still needs a height.
    upper = np.maximum(upper, lower + 1e-3 * (float(np.max(upper - lower)) or 1.0))
    grid = _on_grid(position, change, times, lower, upper)
    parts = (lower, upper, times, grid)
    return Shading(*(jnp.asarray(np.asarray(x), jnp.float32) for x in parts))


class _Comparison:
    """The pictures of a camera that stands still beside their temporal median.

    Args:
        footage: the training pictures.
        own: the frames of the camera.
        position: the points that it looks at.
    """

    def __init__(
        self,
        footage: Footage,
        own: Int[np.ndarray, " frames"],
        position: Float[np.ndarray, "points 3"],
    ):
        self._footage, self._own, film = footage, own, footage.film
        self._step = max(min(film.width, film.height) // _SIDE, 1)
        self._median, self._known = (self._thinned(x) for x in median_picture(footage, own))
        self._window = max(round(_AVERAGED * min(self._known.shape)), 1)
        self._usual = _light(self._median / footage.scale)
        self._count = len(position)
        pixel = np.asarray(projected(footage.camera, jnp.asarray(own[0]), jnp.asarray(position)))
        with np.errstate(invalid="ignore"):
            inside = np.all((pixel >= 0) & (pixel < (film.width, film.height)), axis=1)
        self._inside = np.flatnonzero(inside)
        last = np.array(self._known.shape)[::-1] - 1
        self._column, self._row = np.minimum(pixel[inside].astype(int) // self._step, last).T

    def log_gain(self, time: float) -> Float[np.ndarray, " points"]:
        """Logarithm of how much brighter than usual each point is; NaN where the picture does not
        tell."""
        result = np.full(self._count, np.nan, np.float32)
        frame = self._own[
            self._footage.times[self._own] == np.asarray(time, self._footage.times.dtype)
        ]
        if not len(frame):
            return result
        picture = self._thinned(self._footage.pictures(frame[:1])[0])
        light = _light(picture / self._footage.scale)
        moved = differs(picture, self._median, self._footage.scale)
        counts = self._known & (~moved | _same_hue(light, self._usual))
        mask = self._footage.masks(frame[:1])
        if mask is not None:
            counts &= self._thinned(mask[0])
        still = counts.astype(np.float32)
        now, usual = (self._mean(x.mean(axis=-1) * still) for x in (light, self._usual))
        share = self._mean(still)
        tells = counts & (share > _STANDS_STILL) & (usual > _DARK * share) & (now > 0)
        ratio = np.where(tells, np.log(np.where(tells, now / np.where(tells, usual, 1), 1)), np.nan)
        result[self._inside] = ratio[self._row, self._column]
        return result

    def _thinned(self, picture: np.ndarray) -> np.ndarray:
        return picture[:: self._step, :: self._step]

    def _mean(self, values: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        return uniform_filter(values, self._window, mode="constant")


def _light(encoded: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """Linear light."""
    return srgb_decode(np.asarray(encoded, np.float32))


def _same_hue(
    light: Float[np.ndarray, "h w 3"], usual: Float[np.ndarray, "h w 3"]
) -> Bool[np.ndarray, "h w"]:
    """Which pixels differ from their usual linear light by nearly one factor in all channels: in a
    deep shadow, things keep their hue."""
    ratio = np.log(np.maximum(light, _FAINT)) - np.log(np.maximum(usual, _FAINT))
    mean = ratio.mean(axis=-1, keepdims=True)
    return np.all(np.abs(ratio - mean) < _HUE, axis=-1) & (np.abs(mean[..., 0]) < _DEEPEST)


def _agreed(seen: list[Float[np.ndarray, " points"]]) -> Float[np.ndarray, " points"]:
    """The median over the cameras, less what may be noise; NaN where too few tell."""
    table = np.array(seen)
    count = np.sum(np.isfinite(table), axis=0)
    told = count >= _CAMERAS
    table, result = table[:, told], np.full(table.shape[1], np.nan, np.float32)
    middle = np.nanmedian(table, axis=0)
    apart = np.nanmedian(np.abs(table - middle[None]), axis=0)
    error = _NORMAL * apart / np.sqrt(count[told])
    certain = 1 - (_NOISE * error) ** 2 / np.maximum(middle**2, 1e-12)
    result[told] = middle * np.maximum(certain, 0)
    return result


def _on_grid(
    position: Float[np.ndarray, "points 3"],
    change: Float[np.ndarray, "times points"],
    times: Float[np.ndarray, " times"],
    lower: Float[np.ndarray, "3"],
    upper: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "times x y z"]:
    """Means of the points around each vertex, interpolated over the times at which none tells; 0
    where none ever does."""
    size = np.asarray(upper - lower, np.float64)
    # A box has six sides.
    across = np.clip(np.sqrt(len(position) / (6 * _POINTS_OF_CELL)), _FEWEST_CELLS, _MOST_CELLS)
    cells = np.maximum(np.rint(across * size / size.max()).astype(int), 1)
    place = (position - lower) / size * cells
    within = np.all((place >= 0) & (place <= cells), axis=1)
    place, change = place[within], change[:, within]
    corner = np.minimum(place.astype(int), cells - 1)
    share, rows, weights = place - corner, [], []
    for offset in np.ndindex(2, 2, 2):
        rows.append(np.ravel_multi_index((corner + offset).T, cells + 1))
        weights.append(np.prod(np.where(offset, share, 1 - share), axis=1))
    column = np.tile(np.arange(len(place)), 8)
    entries = np.concatenate(weights), (np.concatenate(rows), column)
    around = csr_array(entries, shape=(int(np.prod(cells + 1)), len(place)))
    known = np.isfinite(change)
    weight = (around @ known.T.astype(np.float32)).T
    mean = (around @ np.nan_to_num(change).T).T / np.maximum(weight, _LEAST_WEIGHT)
    told = weight >= _LEAST_WEIGHT
    mean[:, ~told.any(axis=0)] = 0
    for vertex in np.flatnonzero(told.any(axis=0) & ~told.all(axis=0)):
        own = told[:, vertex]
        mean[:, vertex] = np.interp(times, times[own], mean[own, vertex])
    return mean.reshape(-1, *(cells + 1))
