"""Regularisers of the deformation planes: smooth in space, steady in time."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.scene.planes import Planes


def plane_terms(planes: Planes) -> dict[str, Float[Array, ""]]:
    """The three plane regularisers of HexPlane and 4DGaussians, unweighted.

    `space`: mean squared difference of neighbours in the spatial planes (total variation).
    `time`: mean squared second difference along time. `one`: mean |1 - time plane|, which pulls
    towards a field that does not change.
    """
    space = [_squares(p, 1) + _squares(p, 2) for p in planes.space]
    time = [_squares(jnp.diff(p, axis=1), 1) for p in planes.time]
    one = [jnp.mean(jnp.abs(1 - p)) for p in planes.time]
    return {"space": sum(space), "time": sum(time), "one": sum(one)}  # type: ignore[dict-item]


def _squares(x: Array, axis: int) -> Array:
    difference = jnp.diff(x, axis=axis)
    return jnp.sum(difference * difference) / max(difference.size, 1)
