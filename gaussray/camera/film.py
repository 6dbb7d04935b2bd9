"""The film: picture size and pixel filter."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.io.plain_values import readable, whole_number
from gaussray.io.validate import check_count, check_field_types


FILTERS = ("box", "gaussian", "blackman_harris", "center")
# Cells of the tabulated inverse distribution; even, so that u = 1/2 falls on a knot (offset 0).
CELLS = 1024


class Film(eqx.Module):
    """Size of a picture and its pixel filter.

    Args:
        width: pixels per row, at least 1.
        height: pixels per column, at least 1.
        filter: "box", "gaussian", "blackman_harris", or "center" (rays pass the pixel's centre
            only).
        filter_width: total width of the filter in pixels, per axis. The default 3 of
            blackman_harris is Blender's (whose property counts one side, 1.5); Blender's box is 1.
            The standard deviation of gaussian is a twelfth of the width (Blender's default is 4.5).

    Raises:
        ValueError: If a value breaks its rule.
    """

    width: int = eqx.field(static=True, converter=whole_number)
    height: int = eqx.field(static=True, converter=whole_number)
    filter: str = eqx.field(static=True, default="blackman_harris")
    filter_width: float = eqx.field(static=True, default=3.0)

    def __check_init__(self):
        for key in ("width", "height"):
            check_count(f"film.{key}", getattr(self, key), 1)
        if self.filter not in FILTERS:
            raise ValueError(f"film.filter must be one of {FILTERS}, got {self.filter!r}.")
        check_field_types("film", self)
        if not 0 < self.filter_width < np.inf:
            raise ValueError(
                f"film.filter_width must be above 0, got {self.filter_width}. "
                "Use film.filter=center for one ray through the pixel's centre."
            )

    def __repr__(self) -> str:
        return readable(self)


def sample_offset(film: Film, u: Float[Array, "2"]) -> Float[Array, "2"]:
    """Offset of a sample from the pixel's centre, distributed as the pixel filter.

    Importance sampling by the inverse cumulative distribution, so all samples have equal weight.

    Args:
        film: the film.
        u: two numbers in [0, 1); (1/2, 1/2) is the centre itself.

    Returns:
        Offset (x, y) in pixels.
    """
    if film.filter == "center":
        return jnp.zeros_like(u)
    if film.filter == "box":
        return film.filter_width * (u - 0.5)
    table = jnp.asarray(_inverse_distribution(film.filter), u.dtype)
    position = jnp.clip(u, 0, 1) * CELLS
    cell = jnp.clip(jnp.floor(position).astype(jnp.int32), 0, CELLS - 1)
    low, high = table[cell], table[cell + 1]
    return film.filter_width * (low + (position - cell) * (high - low))


@functools.cache
def _inverse_distribution(filter: str) -> np.ndarray:
    """Offsets, in filter widths, below which lies a share 0, 1/CELLS, ... 1 of the filter."""
    x = np.linspace(-0.5, 0.5, 64 * CELLS + 1)
    if filter == "gaussian":
        weight = np.exp(-2 * (6 * x) ** 2)
    else:
        v = 2 * np.pi * (x + 0.5)
        weight = 0.35875 - 0.48829 * np.cos(v) + 0.14128 * np.cos(2 * v) - 0.01168 * np.cos(3 * v)
    share = np.concatenate([[0], np.cumsum((weight[1:] + weight[:-1]) / 2)])
    table = np.interp(np.linspace(0, 1, CELLS + 1), share / share[-1], x)
    return (table - table[::-1]) / 2  # exactly odd


def pixel_grid(film: Film) -> Float[Array, "h w 2"]:
    """Index (column, row) of every pixel."""
    column, row = jnp.meshgrid(jnp.arange(film.width), jnp.arange(film.height))
    return jnp.stack([column, row], axis=-1).astype(jnp.result_type(float))
