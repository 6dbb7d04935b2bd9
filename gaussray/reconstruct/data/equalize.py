"""Exposures and light that change over time: found in the pictures of cameras that stand still, and
evened out, so that what stands still has the same colours in all pictures of a camera."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from gaussray.capture.spread import spread_indices
from gaussray.capture.temporal_median import visible_median
from gaussray.color import srgb_decode, srgb_encode
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.still_cameras import FEWEST_FRAMES, camera_frames
from gaussray.scene.light import Light


# Pixels of each picture that are compared, at most, and of all pictures of a camera together.
_PIXELS, _IN_ALL = 4096, 1 << 18
# sRGB-encoded values that are compared: darker ones are noise, brighter ones may be clipped.
_DARK, _BRIGHT = 0.1, 0.95
# A pixel agrees with its picture's gain if it differs from it by less, in natural logarithms.
_AGREES = 0.12
# Share of the compared pixels that must agree, and their least number.
_SHARE, _LEAST = 0.5, 64
# Standard deviation over time, of natural logarithms, below which gains are left alone: bounced
# light of what moves changes a picture by as much, and that belongs to the scene.
_SLIGHT = 0.02
# Cameras that must share a change for it to be one of the light, and the largest share of a
# camera's variance that this may leave.
_CAMERAS, _LEFT = 3, 0.5
# Medians over times and over pixels in turn; means over the pixels that agree.
_ROUNDS, _MEANS = 4, 3


class Equalization(NamedTuple):
    """How much brighter than usual each picture is, in linear red, green and blue.

    Args:
        exposure: factor of each picture by its camera's own exposure.
        light: the light over time; None if it does not change.
    """

    exposure: Float[np.ndarray, "frames 3"]
    light: Light | None

    @property
    def sentence(self) -> str:
        """One line that says what changes, and by how much."""
        changes = {"exposures": self.exposure}
        if self.light is not None:
            changes = {"the light": np.asarray(self.light.gain)} | changes
        parts = [
            f"{what} by up to {np.ptp(np.log2(gain), axis=0).max():.1f} stops"
            for what, gain in changes.items()
            if np.any(gain != 1)
        ]
        return f"Changes over time, evened out (fit.equalize): {', '.join(parts)}."


def equalization(footage: Footage) -> Equalization | None:
    """What exposures and light that change over time do to the pictures of cameras that stand
    still.

    The logarithm of a pixel's linear light is the sum of the pixel's own, of its picture's gain,
    and of a difference where something moves. The first two are found as medians over the times of
    each pixel and over the pixels of each picture in turn. A camera counts if most of its pixels
    agree with that. What explains more than half of the gains of at least three cameras is the
    light; the rest are their exposures.

    Args:
        footage: the training pictures.

    Returns:
        None if nothing changes, or too few pixels tell.
    """
    log_gain, cameras = np.zeros((len(footage.times), 3)), []
    for own, still in camera_frames(footage):
        found = _camera_gain(footage, own) if still and len(own) >= FEWEST_FRAMES else None
        if found is not None:
            log_gain[own] = found
            cameras.append(own)
    light, usual = _shared(log_gain, footage.times, cameras), np.zeros_like(log_gain)
    if light is not None:
        usual = _log_gain(light, footage.times)
    for own in cameras:
        rest = log_gain[own] - usual[own]
        log_gain[own] = 0 if _is_slight(rest) else rest
    if light is None and not log_gain.any():
        return None
    return Equalization(np.exp(log_gain), light)


def _camera_gain(
    footage: Footage, own: Int[np.ndarray, " frames"]
) -> Float[np.ndarray, "frames 3"] | None:
    """Logarithms of the gains of a camera's pictures, with a median of 0; None if too few pixels
    agree on them."""
    level = _levels(footage, own)
    compared = np.isfinite(level[..., 0])
    level = level[:, compared.mean(axis=0) >= 0.5]
    compared = np.isfinite(level[..., 0])
    if level.shape[1] < _LEAST or not compared.any(axis=1).all():
        return None
    gain = np.zeros((len(level), 1, 3))
    for _ in range(_ROUNDS):
        usual = visible_median(level - gain, compared)
        apart = level - usual
        gain = visible_median(np.swapaxes(apart, 0, 1), compared.T)[:, None]
        for _ in range(_MEANS):
            rest = apart - gain
            agrees = _agreeing(rest)
            total = np.where(agrees, rest, 0).sum(axis=1, keepdims=True)
            gain = gain + total / np.maximum(agrees.sum(axis=1, keepdims=True), 1)
        gain = gain - np.median(gain, axis=0)
    agrees = _agreeing(level - usual - gain)
    return gain[:, 0] if agrees.sum() >= _SHARE * compared.sum() else None


def _levels(footage: Footage, own: Int[np.ndarray, " frames"]) -> Float[np.ndarray, "frames n 3"]:
    """Logarithms of linear light of some pixels of a camera's pictures; NaN where one channel is
    too dark, too bright, or the pixel does not count."""
    tiles, pixels = footage.pixel.shape[1:3]
    most = min(_PIXELS, max(_IN_ALL // len(own), _LEAST))
    chosen = spread_indices(tiles * pixels, most)
    tile, place = np.divmod(chosen, pixels)
    result = np.empty((len(own), len(chosen), 3))
    for row, frame in enumerate(own):
        encoded = footage.pixel[frame, tile, place].astype(np.float32) / footage.scale
        tells = np.all((encoded > _DARK) & (encoded < _BRIGHT), axis=-1)
        visible = footage.visible(frame)
        if visible is not None:
            tells &= visible[tile, place]
        light = np.maximum(srgb_decode(encoded), 1e-6)
        result[row] = np.where(tells[:, None], np.log(light), np.nan)
    return result


def _agreeing(rest: Float[np.ndarray, "frames n 3"]) -> Bool[np.ndarray, "frames n 1"]:
    """The pixels that differ from their picture's gain by little in every channel."""
    return np.all(np.abs(rest) < _AGREES, axis=-1, keepdims=True)


def _is_slight(log_gain: Float[np.ndarray, "times 3"]) -> bool:
    return bool(np.median(np.std(log_gain, axis=0)) < _SLIGHT)


def _shared(
    log_gain: Float[np.ndarray, "frames 3"],
    time: Float[np.ndarray, " frames"],
    cameras: Sequence[np.ndarray],
) -> Light | None:
    """The light that explains most of what cameras have found; None if none does."""
    if len(cameras) < _CAMERAS:
        return None
    known = np.concatenate(cameras)
    times, taken = np.unique(time[known], return_counts=True)
    enough = times[taken >= _CAMERAS]
    if len(enough) < max(len(times) / 2, 2):
        return None
    medians = np.stack([np.median(log_gain[known[time[known] == t]], axis=0) for t in enough])
    light = Light(jnp.asarray(enough), jnp.exp(jnp.asarray(medians - np.median(medians, axis=0))))
    rest = log_gain - _log_gain(light, time)
    left = [np.var(rest[own]) / max(float(np.var(log_gain[own])), 1e-12) for own in cameras]
    return None if _is_slight(medians) or np.median(left) > _LEFT else light


def _log_gain(light: Light, time: Float[np.ndarray, " frames"]) -> Float[np.ndarray, "frames 3"]:
    return np.log(np.asarray(light.at(jnp.asarray(time)), np.float64))


def equalized(footage: Footage, found: Equalization) -> Footage:
    """The pictures as they would be with their cameras' usual exposure in usual light.

    The footage's own pictures are changed: there may be no room for both. What is at full scale
    stays there, for how much brighter it was is not known.

    Args:
        footage: the training pictures.
        found: their gains.
    """
    pixel, full = footage.pixel, footage.scale
    gains = found.exposure
    if found.light is not None:
        gains = gains * np.exp(_log_gain(found.light, footage.times))
    for frame in np.flatnonzero(np.any(gains != 1, axis=1)):
        gain = gains[frame].astype(np.float32)
        if pixel.dtype == np.uint8:
            levels = np.arange(256, dtype=np.float32)[:, None] / full
            table = np.clip(srgb_encode(srgb_decode(levels) / gain), 0, 1)
            table = np.floor(full * table + 0.5).astype(np.uint8)
            table[-1] = full
            for channel in range(3):
                levels = pixel[frame, ..., channel]
                pixel[frame, ..., channel] = np.take(table[:, channel], levels)
        else:
            light = np.clip(srgb_encode(srgb_decode(pixel[frame]) / gain), 0, 1)
            pixel[frame] = np.where(pixel[frame] < 1, light, 1)
    footage.medians.clear()
    return footage
