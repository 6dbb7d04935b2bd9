"""Plain backdrops: a studio's, or the colour that transparent pixels are composited over."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.capture.spread import spread_indices
from gaussray.color import srgb_decode
from gaussray.reconstruct.data.pictures import Footage


# A colour is a backdrop's if at least this share of all pixels at the pictures' borders differs
# from it by no more than so much (of 1, in each channel; what is as near to it is backdrop, too).
_SHARE, _EVEN = 0.5, 0.012
# Share of these pixels that masks must leave to tell a backdrop.
_VISIBLE = 0.1
# Pictures whose borders are looked at.
_LOOKED_AT = 32

# A colour is called black or white if no channel is so far from it.
_NAMED = 0.02

_Values = np.ndarray | Array
# The sRGB-encoded colour of a backdrop, as a constant of a program.
BackdropColor = tuple[float, float, float]


def backdrop_of(footage: Footage) -> BackdropColor | None:
    """The sRGB-encoded colour of a plain backdrop; None if the pictures have none.

    Args:
        footage: the training pictures; pixels that are masked do not count.
    """
    chosen = spread_indices(len(footage.times), _LOOKED_AT)
    edge = np.ones((footage.film.height, footage.film.width), bool)
    edge[1:-1, 1:-1] = False
    border, visible = footage.pictures(chosen)[:, edge], footage.masks(chosen)
    least = _VISIBLE * border[..., 0].size
    border = border.reshape(-1, 3) if visible is None else border[visible[:, edge]]
    if len(border) < least:
        return None
    color = border.astype(np.float32) / footage.scale
    red, green, blue = np.median(color, axis=0).tolist()
    plain = red, green, blue
    return plain if surrounds(color, plain) else None


def backdrop_sentence(plain: BackdropColor) -> str:
    """What is said of pictures that have a plain backdrop, so that its absence shows, too.

    Args:
        plain: sRGB-encoded colour of the backdrop.
    """
    levels = " ".join(str(round(255 * x)) for x in plain)
    black, white = max(plain) < _NAMED, min(plain) > 1 - _NAMED
    color = "black" if black else "white" if white else f"of one colour (sRGB {levels})"
    return (
        f"Most of the pictures' border is {color}: that is taken as a plain backdrop, and pixels "
        "that show it as empty (loss.backdrop_opacity)."
    )


def surrounds(border: Float[np.ndarray, "pixels 3"], plain: BackdropColor) -> bool:
    """Whether a colour is a backdrop's: most pixels at the borders of pictures have it.

    Args:
        border: sRGB-encoded colours of these pixels, in 0..1.
        plain: sRGB-encoded colour.
    """
    return bool(len(border)) and bool(like_backdrop(border, plain).mean() >= _SHARE)


def like_backdrop(
    color: Float[_Values, "*pixels 3"], plain: BackdropColor
) -> Bool[_Values, "*pixels"]:
    """Which colours differ from that of a backdrop by no more than noise: JPEG does not keep it.

    Args:
        color: sRGB-encoded colours, in 0..1.
        plain: sRGB-encoded colour of the backdrop.
    """
    apart: Any = abs(color - np.array(plain, color.dtype).reshape(*[1] * (color.ndim - 1), 3))
    return (apart <= _EVEN).all(axis=-1)


def before_backdrop(
    color: Float[Array, "*rays 3"],
    transmittance: Float[Array, "*rays"],
    plain: BackdropColor | Float[Array, "3"],
) -> Float[Array, "*rays 3"]:
    """Linear light of rays whose rest ends at a backdrop.

    Args:
        color: linear light of what the rays meet.
        transmittance: share of the backdrop's light that passes.
        plain: sRGB-encoded colour of the backdrop.
    """
    light = srgb_decode(jnp.asarray(plain, color.dtype))
    return color + transmittance[..., None] * light.reshape(*[1] * (color.ndim - 1), 3)
