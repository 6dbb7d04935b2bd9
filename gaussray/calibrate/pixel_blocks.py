"""A picture divided into square blocks of pixels, whose mean colours are compared."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.color import srgb_encode
from gaussray.tracer.bundle import fill_padding, morton_tiles


# Rays along the side of a block, at most, and ray tiles that are traced together: with fixed sizes
# one compiled program serves all levels.
_SIDE, _TILES = 4, 64


class PixelBlocks(eqx.Module):
    """Blocks of pixels of a picture: the rays that sample them and their mean colours.

    Args:
        pixel: index (column, row) of each ray's pixel.
        weight: weight of each ray; 0 outside the mask and in padding.
        truth: sRGB-encoded mean colour of each block.
    """

    pixel: Float[Array, "rays 2"]
    weight: Float[Array, " rays"]
    truth: Float[Array, "blocks 3"]

    @property
    def side(self) -> int:
        """Rays along the side of a block."""
        return round((self.weight.shape[0] / self.truth.shape[0]) ** 0.5)


def pixel_blocks(
    light: Float[np.ndarray, "h w 3"], mask: np.ndarray, factor: int, *, bundle: int
) -> list[PixelBlocks]:
    """Divide a picture into blocks of `factor` x `factor` pixels and place rays in them.

    A block's mean colour is the mean of all its pixels. Its rendered colour is the mean of at most
    4 x 4 evenly spread rays through whole pixels, so that row times and lens need no scaling.

    Args:
        light: the picture in linear light.
        mask: weight of each pixel; 0 leaves it out.
        factor: pixels along the side of a block.
        bundle: rays along the side of a ray tile; a tile holds whole blocks.

    Returns:
        Groups of equal size, at most 64 ray tiles each, so that one compiled program fits all.
    """
    (height, width), dtype = mask.shape, light.dtype
    side = min(factor, _SIDE, bundle & -bundle)
    across, down = -(-width // factor), -(-height // factor)
    mean, weight_of = _block_means(light, mask, factor, (down, across))

    order = morton_tiles(across * side, down * side, bundle, 0)
    inside = (order >= 0).reshape(-1, bundle**2)
    y, x = np.divmod(fill_padding(order).reshape(-1, bundle**2), across * side)
    place = ((np.arange(side) + 0.5) * factor / side).astype(int)
    row, column = (v // side * factor + place[v % side] for v in (y, x))
    weight = weight_of[row, column] * inside
    each = bundle // side
    first = (slice(None), slice(0, None, side), slice(0, None, side))
    block = tuple(v.reshape(-1, bundle, bundle)[first].reshape(-1, each**2) for v in (y, x))
    truth = srgb_encode(mean[block[0] // side, block[1] // side])

    used = np.flatnonzero(weight.any(axis=1))
    most = min(_TILES, -(-width // bundle) * -(-height // bundle))
    pixel = np.stack([column, row], axis=-1)
    return [
        _group([x[used[i : i + most]] for x in (pixel, weight, truth)], most, dtype)
        for i in range(0, len(used), most)
    ]


def _block_means(light, mask, factor, shape):
    """Mean linear light of each block, and the mask, padded to whole blocks."""
    (height, width), (down, across) = mask.shape, shape
    pad = (0, down * factor - height), (0, across * factor - width)
    padded = np.pad(mask.astype(np.float64), pad)
    light = np.pad(light.astype(np.float64), (*pad, (0, 0))) * padded[..., None]
    split = down, factor, across, factor
    count = padded.reshape(split).sum(axis=(1, 3))
    mean = light.reshape(*split, 3).sum(axis=(1, 3)) / np.maximum(count, 1)[..., None]
    return mean, padded


def _group(tiled, count, dtype) -> PixelBlocks:
    """Pixels, weights and truth of some ray tiles, padded with zeros to `count` tiles."""
    pixel, weight, truth = (
        np.pad(x, [(0, count - len(x))] + [(0, 0)] * (x.ndim - 1)) for x in tiled
    )
    flat = pixel.reshape(-1, 2), weight.reshape(-1), truth.reshape(-1, 3)
    return PixelBlocks(*(jnp.asarray(x, dtype) for x in flat))
