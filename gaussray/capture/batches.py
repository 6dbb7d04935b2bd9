"""Training footage on the device, and the tiles of it that one step looks at."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.rays import Rays
from gaussray.capture.calibration import View
from gaussray.capture.errors import CaptureError
from gaussray.capture.frames import load_encoded, read_mask


class Footage(eqx.Module):
    """Every training picture (sRGB-encoded) with its camera; the leading axis is the frame.

    `mask` is False where a picture is to be ignored, None if no view has a mask.
    """

    picture: Array
    camera: Camera
    mask: Bool[Array, "frames h w"] | None

    @property
    def times(self) -> np.ndarray:
        """Time of every picture."""
        return np.asarray(self.camera.time)


def footage(views: list[View]) -> Footage:
    """Pictures of the views in memory (8 bit where the files are) and their cameras, stacked."""
    if not views:
        raise CaptureError(
            "capture.path holds no view of split 'train'. Mark some frames with "
            '"split": "train" in transforms.json.'
        )
    first = _kind(views[0].camera)
    for view in views:
        if _kind(view.camera) != first:
            raise CaptureError(
                f"{view.image}: training views must share one size, lens model, film and number of "
                f"poses, but this one differs from {views[0].image}. Resize the pictures or use "
                "one kind of camera."
            )
    camera = jax.tree.map(lambda *x: jnp.stack(x), *(view.camera for view in views))
    mask = None
    if any(view.mask is not None for view in views):
        masks = [
            np.ones((view.height, view.width), bool)
            if view.mask is None
            else read_mask(view.mask, view.width, view.height, view.window)
            for view in views
        ]
        mask = jnp.asarray(np.stack(masks))
    return Footage(jnp.asarray(load_encoded(views)), camera, mask)


def _kind(camera: Camera) -> tuple:
    """What must be alike for cameras to be stacked."""
    return jax.tree.structure(camera), [leaf.shape for leaf in jax.tree.leaves(camera)]


def tile_grid(footage: Footage, side: int) -> tuple[int, int]:
    """Columns and rows of tiles; the last ones overlap their neighbours where nothing divides."""
    height, width = footage.picture.shape[1:3]
    if min(height, width) < side:
        raise CaptureError(
            f"trace.bundle must be at most the picture's smaller side, got {side} for a picture of "
            f"{width} x {height}."
        )
    return -(-width // side), -(-height // side)


def tile_rays(
    camera: Camera, tile: Int[Array, " tiles"], u: Float[Array, "samples 5"], *, side: int
) -> Rays:
    """Rays through the tiles' pixels, tile after tile, for every sample `u` (see `camera_ray`).

    `camera` is a stack: the camera that sees each tile.
    """
    x, y = _tile_pixels(tile, camera.film.width, camera.film.height, side)
    pixel = jnp.stack([x, y], axis=-1).astype(camera.time.dtype)

    def one(camera: Camera, pixel: Array, u: Array) -> Rays:
        return camera_rays(camera, pixel, jnp.broadcast_to(u, (pixel.shape[0], u.shape[0])))

    each = jax.vmap(jax.vmap(one, in_axes=(0, 0, None)), in_axes=(None, None, 0))
    rays = each(camera, pixel, u.astype(pixel.dtype))
    return jax.tree.map(lambda x: x.reshape(x.shape[0], -1, *x.shape[3:]), rays)


def tile_colors(
    footage: Footage, frame: Int[Array, " tiles"], tile: Int[Array, " tiles"], *, side: int
) -> tuple[Float[Array, "rays 3"], Float[Array, " rays"]]:
    """Encoded colours in [0, 1] of the tiles' pixels, tile after tile, and the weight of each (0
    where masked)."""
    height, width = footage.picture.shape[1:3]
    x, y = (part.reshape(-1) for part in _tile_pixels(tile, width, height, side))
    frame, dtype = jnp.repeat(frame, side**2), footage.camera.time.dtype
    scale = 255 if footage.picture.dtype == jnp.uint8 else 1
    color = footage.picture[frame, y, x].astype(dtype) / scale
    if footage.mask is None:
        return color, jnp.ones(x.shape, dtype)
    return color, footage.mask[frame, y, x].astype(dtype)


def _tile_pixels(
    tile: Int[Array, " tiles"], width: int, height: int, side: int
) -> tuple[Int[Array, "tiles pixels"], Int[Array, "tiles pixels"]]:
    """Columns and rows of the pixels of tiles, row after row."""
    columns = -(-width // side)
    left = jnp.minimum(tile % columns * side, width - side)
    top = jnp.minimum(tile // columns * side, height - side)
    dy, dx = (x.reshape(-1)[None] for x in jnp.mgrid[:side, :side])
    return left[:, None] + dx, top[:, None] + dy


class Sampler:
    """Draws the tiles of each step, more of them where things move. Same seed, same tiles."""

    def __init__(
        self,
        times: np.ndarray,
        activity: Float[np.ndarray, "frames tiles"],
        *,
        tiles: int,
        balance: float,
    ):
        self.times = np.unique(times)
        self._own = [np.flatnonzero(times == t) for t in self.times]
        self._tiles, self._count = tiles, activity.shape[1]
        self._share = []
        for own in self._own:
            active = activity[own].reshape(-1).astype(np.float64)
            even = np.full(active.size, 1 / active.size)
            moving = active / active.sum() if active.sum() > 0 else even
            self._share.append((1 - balance) * even + balance * moving)

    def draw(
        self, instants: Int[np.ndarray, " steps"], dice: np.random.Generator
    ) -> tuple[Int[np.ndarray, "steps tiles"], Int[np.ndarray, "steps tiles"]]:
        """Frame and tile of every bundle, for steps at the given instants (indices of `times`).

        Each step sees one instant from all cameras. A share `balance` of the tiles is drawn in
        proportion to the pixels that move in them, the rest evenly.
        """
        frame = np.empty((len(instants), self._tiles), np.int32)
        tile = np.empty_like(frame)
        for row, instant in enumerate(instants):
            share = self._share[instant]
            picked = dice.choice(share.size, self._tiles, replace=self._tiles > share.size, p=share)
            frame[row] = self._own[instant][picked // self._count]
            tile[row] = picked % self._count
        return frame, tile
