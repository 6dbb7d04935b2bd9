"""The pixels of a view that are refined: a list, in parts of one size.

What moves is a tenth of a picture. Arrays have room for all pixels, so that one program does for
any number of them, and a loop ends with the last part that holds any.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped


class PixelList(NamedTuple):
    """The chosen pixels of a view, row by row; the slots after the last repeat a pixel.

    Args:
        pixel: number of the pixel in each slot.
        slot: slot of each pixel; of one that is not listed, that of the last one before it which
            is.
        counts: which pixels are listed.
        parts: number of parts that hold any.
        size: number of slots in a part.
    """

    pixel: Int[Array, " slots"]
    slot: Int[Array, "h w"]
    counts: Bool[Array, "h w"]
    parts: Int[Array, ""]
    size: int

    def listed(self, picture: Shaped[Array, "*axes h w"]) -> Shaped[Array, "*axes slots"]:
        """The values of a picture, or of a stack of them, in every slot."""
        return picture.reshape(*picture.shape[:-2], -1)[..., self.pixel]

    def picture(
        self, listed: Float[Array, "*axes slots"], other: Float[Array, "*axes h w"]
    ) -> Float[Array, "*axes h w"]:
        """The picture, or a stack, of values of all slots.

        Args:
            listed: the values.
            other: the picture's values at pixels that are not listed.
        """
        return jnp.where(self.counts, listed[..., self.slot], other)

    def part(self, k: Int[Array, ""], listed: Shaped[Array, "*axes slots"]) -> Array:
        """The values of a part.

        Args:
            k: number of the part.
            listed: values of all slots.
        """
        return jax.lax.dynamic_slice_in_dim(listed, k * self.size, self.size, axis=-1)

    def with_part(self, k: Int[Array, ""], listed: Array, values: Array) -> Array:
        """Listed values, those of a part replaced.

        Args:
            k: number of the part.
            listed: values of all slots.
            values: those of the part.
        """
        return jax.lax.dynamic_update_slice_in_dim(listed, values, k * self.size, axis=-1)


def pixel_list(counts: Bool[Array, "h w"], parts: Int[Array, ""], size: int) -> PixelList:
    """The list of chosen pixels.

    Args:
        counts: which pixels are listed.
        parts: number of parts that are gone through; several views of one batch share it.
        size: number of slots in a part.
    """
    room = -(-counts.size // size) * size
    (pixel,) = jnp.nonzero(counts.reshape(-1), size=room, fill_value=0)
    slot = jnp.cumsum(counts.reshape(-1), dtype=jnp.int32) - 1
    slot = jnp.maximum(slot, 0).reshape(counts.shape)
    return PixelList(pixel.astype(jnp.int32), slot, counts, parts, size)
