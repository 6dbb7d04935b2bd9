"""The principal point: the pixel of the optical axis."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.lens import AbstractLens


def axis_of(lens: AbstractLens, dtype: DTypeLike) -> Float[Array, "2"]:
    """Pixel (column, row) of the optical axis, which may lie outside the picture; NaN where the
    lens does not image it.

    Args:
        lens: the lens.
        dtype: precision of the result.
    """
    return lens.project(jnp.asarray([0, 0, 1], dtype))


def require_axis(key: str, lens: AbstractLens) -> None:
    """Check that a lens images its optical axis.

    Args:
        key: the option that counts from the axis, for the message.
        lens: the lens.

    Raises:
        ValueError: the lens does not image its axis.
    """
    if not np.all(np.isfinite(axis_of(lens, jnp.float32))):
        raise ValueError(
            f"{key} counts from the optical axis, which this lens does not image: its theta(r) "
            "does not reach 0. Leave the key off, or give lens.k a first coefficient of 0."
        )
