"""Whether a lens gives every pixel of a picture a direction of its own."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.camera.lens.abstract import AbstractLens


def check_lens(lens: AbstractLens, width: int, height: int) -> None:
    """Raise unless the lens is valid and every pixel has a direction of its own.

    A coarse grid of pixels, the corners' among them, is sent through `direction` and back through
    `project`. Black pixels are no error, except under a pinhole, where they mean that the
    distortion folds.
    """
    lens.check()
    side = np.linspace(0, 1, 9)
    columns, rows = 0.5 + side * (width - 1), 0.5 + side * (height - 1)
    pixel = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    pixel = jnp.asarray(pixel, jnp.result_type(*jax.tree.leaves(lens)))
    lit, back = jax.jit(_round_trip)(lens, pixel)
    close = np.max(np.abs(back - pixel), axis=-1) < 0.1
    wrong = np.where(lit, ~close, lens.fills_picture)
    if wrong.any():
        key, remedy = lens.fold_message
        raise ValueError(
            f"{key} must give every pixel a direction of its own, got none or another pixel's at "
            f"{np.asarray(pixel)[wrong][0].tolist()} (column, row). {remedy}"
        )


def _round_trip(
    lens: AbstractLens, pixel: Float[Array, "pixels 2"]
) -> tuple[Bool[Array, " pixels"], Float[Array, "pixels 2"]]:
    """Whether the lens sees each pixel, and the pixel that its ray comes back to."""
    direction = jax.vmap(lens.direction)(pixel)
    return jnp.any(direction != 0, axis=-1), jax.vmap(lens.project)(direction)
