"""Checks that a lens maps every pixel of a picture to a different direction."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.camera.lens.abstract import AbstractLens
from gaussray.camera.lens.equirectangular import Equirectangular
from gaussray.io.validate import known
from gaussray.runtime.program_cache import quick_compilation
from gaussray.runtime.stored_programs import KeptProgram


# Pixels of a side that are looked at, and the share of the picture that each stands for: those of
# the border have neighbours on one side alone.
_SIDE = 9
_HALVED = np.where(np.isin(np.arange(_SIDE), (0, _SIDE - 1)), 0.5, 1.0)
_SHARES = np.outer(_HALVED, _HALVED).ravel()


def check_lens(lens: AbstractLens, width: int, height: int, dark: float = 0.0) -> float:
    """Check a lens for pictures of a size.

    A grid of 9 x 9 pixels, corners included, is mapped by `direction` and back by `project`. Pixels
    without a direction (black) are no error, except under a pinhole, where the distortion folds.

    Args:
        lens: the lens.
        width: width of the picture in pixels.
        height: height of the picture in pixels.
        dark: largest share of the picture that may have no direction under a pinhole, too.

    Returns:
        The share of the picture that has no direction, as the grid tells it.

    Raises:
        ValueError: If a parameter is invalid, or if two pixels share a direction.
    """
    lens.check()
    side = np.linspace(0, 1, _SIDE)
    columns, rows = 0.5 + side * (width - 1), 0.5 + side * (height - 1)
    pixel = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    # One precision, which no number weakens: equal lenses share a program.
    dtype = jnp.result_type(*jax.tree.leaves(lens))
    whole, pixel = jax.tree.map(lambda x: np.asarray(x, dtype), (lens, pixel))
    lit, back = map(np.asarray, _round_trip()(whole, pixel))
    close = np.max(np.abs(back - pixel), axis=-1) < 0.1
    if dark and lens.fills_picture:
        # Where distortion turns back, a ray may be formed that comes back to no pixel.
        lit = lit & ~np.isnan(back).any(axis=-1)
    lacking = 1 - float(np.average(lit, weights=_SHARES))
    wrong = np.where(lit, ~close, lens.fills_picture and lacking > dark)
    if wrong.any():
        key, remedy = lens.fold_message
        raise ValueError(
            f"{key} must give every pixel a direction of its own, got none or another pixel's at "
            f"{np.asarray(pixel)[wrong][0].tolist()} (column, row). {remedy}"
        )
    return lacking


def check_span(lens: AbstractLens, width: int, height: int) -> None:
    """Check that a picture holds no more than the whole sphere: what of `check_lens` costs nothing.

    A picture whose border pixels lie beyond by no more than half a pixel is none.

    Args:
        lens: the lens. One of traced numbers is not checked.
        width: width of the picture in pixels.
        height: height of the picture in pixels.

    Raises:
        ValueError: The picture holds more.
    """
    if not isinstance(lens, Equirectangular) or not known(lens.focal):
        return
    most = np.asarray(lens.focal) * (2, 1)
    if np.any(np.array((width, height)) > most + 1):
        key, remedy = lens.fold_message
        raise ValueError(
            f"{key} must be at least {[max(width - 1, 1) / 2, max(height - 1, 1)]} for pictures of "
            f"{width} x {height} pixels, got {np.asarray(lens.focal).tolist()}. {remedy}"
        )


def _there_and_back(
    lens: AbstractLens, pixel: Float[Array, "pixels 2"]
) -> tuple[Bool[Array, " pixels"], Float[Array, "pixels 2"]]:
    """Whether the lens sees each pixel, and the pixel that its ray comes back to."""
    direction = jax.vmap(lens.direction)(pixel)
    return jnp.any(direction != 0, axis=-1), jax.vmap(lens.project)(direction)


@functools.cache
def _round_trip() -> KeptProgram:
    return KeptProgram(_there_and_back, (), quick_compilation())
