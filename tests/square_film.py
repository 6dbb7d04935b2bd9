"""A film of a square that moves, by two cameras."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from textured_plane import PLACES, SIZE, perspective, rig

from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import cut, tile_pixels


TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
SIDE = 8
# Where the square stands in frame k: columns 8 k to 8 k + 8.
ROWS = slice(16, 28)


def film_of_square(*, moving_camera=False):
    """Two cameras of five frames each: an even background, and a white square that moves; the
    second camera may move too."""
    base = rig(perspective(), [PLACES[0]] * 5 + [PLACES[1]] * 5)
    times = jnp.asarray(TIMES * 2, jnp.float32)
    base = eqx.tree_at(lambda c: c.time, base, times)
    if moving_camera:
        shift = jnp.arange(5.0)[:, None, None] * jnp.asarray([0.1, 0, 0])[None, None]
        path = base.trajectory.translation
        path = path.at[5:].add(shift)
        base = eqx.tree_at(lambda c: c.trajectory.translation, base, path)
    pictures = np.full((10, SIZE, SIZE, 3), 60, np.uint8)
    for k in range(10):
        pictures[k, ROWS, 8 * (k % 5) : 8 * (k % 5) + 8] = 255
    pixels = tile_pixels(base.film, SIDE)
    tiles = np.stack([cut(picture, pixels) for picture in pictures])
    names = np.array(["a"] * 5 + ["b"] * 5)
    fields = {field.name for field in dataclasses.fields(Footage)}
    extra = {"bundle": SIDE} if "bundle" in fields else {}
    return Footage(tiles, None, base, names, SIDE, **extra), pictures
