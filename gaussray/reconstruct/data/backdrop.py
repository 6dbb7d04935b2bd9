"""Plain backdrops: a studio's, or the colour that transparent pixels are composited over."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.reconstruct.data.pictures import Footage


# A colour is a backdrop's if at least this share of all pixels at the pictures' borders differs
# from it by no more than so much (of 1, in each channel; what is as near to it is backdrop, too).
_SHARE, _EVEN = 0.5, 0.012
# A backdrop whose channels are below this is black.
_BLACK = 0.02
# Pictures whose borders are looked at.
_LOOKED_AT = 32


def backdrop_among(border: Float[np.ndarray, "pixels 3"]) -> Float[np.ndarray, "3"] | None:
    """The colour that most pixels at the borders of pictures share; None if there is none.

    Args:
        border: sRGB-encoded colours of these pixels, in 0..1.
    """
    if not len(border):
        return None
    middle = np.median(border, axis=0)
    return middle if like_backdrop(border, middle).mean() >= _SHARE else None


def backdrop_of(footage: Footage) -> Float[np.ndarray, "3"] | None:
    """The sRGB-encoded colour of a plain backdrop; None if the pictures have none.

    Args:
        footage: the training pictures; pixels that are masked do not count.
    """
    chosen = np.unique(np.linspace(0, len(footage.times) - 1, _LOOKED_AT).round().astype(int))
    edge = np.ones((footage.film.height, footage.film.width), bool)
    edge[1:-1, 1:-1] = False
    border, visible = footage.pictures(chosen)[:, edge], footage.masks(chosen)
    border = border.reshape(-1, 3) if visible is None else border[visible[:, edge]]
    return backdrop_among(border.astype(np.float32) / footage.scale)


def like_backdrop(
    color: Float[np.ndarray, "*pixels 3"], plain: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, "*pixels"]:
    """Which colours differ from that of a backdrop by no more than noise.

    Args:
        color: sRGB-encoded colours, in 0..1.
        plain: sRGB-encoded colour of the backdrop.
    """
    return np.all(np.abs(color - plain) <= _EVEN, axis=-1)


def is_black(plain: Float[np.ndarray, "3"] | None) -> bool:
    """Whether there is a backdrop, and it is black: where nothing is, a picture is black."""
    return plain is not None and float(plain.max()) < _BLACK


def shows_nothing(truth: Float[Array, "*pixels 3"]) -> Bool[Array, "*pixels"]:
    """Which pixels of pictures with a black backdrop show it. JPEG does not keep zeros.

    Args:
        truth: sRGB-encoded colours, in 0..1.
    """
    return jnp.max(truth, axis=-1) <= _EVEN
