"""Masks of the pixels that an evaluation scores: visible, moving, static."""

from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, UInt8

from gaussray.camera.camera import Camera
from gaussray.camera.film import pixel_grid
from gaussray.capture.capture import View, viewpoints
from gaussray.capture.frames import read_encoded
from gaussray.capture.temporal_median import moving_mask
from gaussray.evaluate.metrics import unit_values


def view_levels(view: View) -> UInt8[np.ndarray, "h w 3"]:
    """The picture of a view in 8-bit sRGB levels."""
    picture = read_encoded(view)
    if picture.dtype == np.uint8:
        return picture
    return np.clip(np.round(picture * 255), 0, 255).astype(np.uint8)


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


def moving_masks(views: Sequence[View]) -> dict[Path, Bool[np.ndarray, "h w"]]:
    """The mask of moving pixels of each picture, from all pictures of the same viewpoint.

    Pictures of a moving camera have no common viewpoint and no mask.
    """
    groups: dict[int, list[View]] = {}
    for number, view in zip(viewpoints(views), views, strict=True):
        groups.setdefault(number, []).append(view)
    masks = {}
    for group in groups.values():
        if len(group) > 1:
            frames = unit_values(np.stack([view_levels(view) for view in group]), np.float32)
            masks |= dict(zip([v.image for v in group], moving_mask(frames), strict=True))
    return masks


def static_masks(
    views: Sequence[View], moving: dict[Path, Bool[np.ndarray, "h w"]]
) -> dict[str, Bool[np.ndarray, "h w"]]:
    """Pixels in which nothing ever moves, for each fixed camera with several pictures.

    Args:
        views: All views.
        moving: Moving pixels of each picture (`moving_masks`).

    Returns:
        The masks by camera name.
    """
    static: dict[str, Bool[np.ndarray, "h w"]] = {}
    places: dict[str, set[int]] = {}
    for number, view in zip(viewpoints(views), views, strict=True):
        places.setdefault(view.camera_name, set()).add(number)
    for view in views:
        if view.image in moving and len(places[view.camera_name]) == 1:
            mask = ~moving[view.image]
            static[view.camera_name] = static.get(view.camera_name, mask) & mask
    return static
