"""Which way the surface faces that a Gaussian is a piece of."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.geometry import product, rotation_matrix
from gaussray.scene.gaussians import Gaussians


def normals(gaussians: Gaussians, eye: Float[Array, "3"]) -> Float[Array, "*keys n 3"]:
    """Unit normal of every Gaussian in the world: its shortest axis, turned to the place `eye`.

    A disc has one, a ball has none that means anything. With key states, axis and side are those
    of the middle one, so that the normal goes on smoothly from key to key.
    """

    def then(x: Array) -> Array:
        return x[x.shape[0] // 2] if x.ndim == 3 else x

    axis = jax.nn.one_hot(jnp.argmin(then(gaussians.scale), axis=-1), 3, dtype=eye.dtype)
    normal = product("...nij,nj->...ni", rotation_matrix(gaussians.quat), axis)
    away = jnp.sum(then(normal) * (eye[None] - then(gaussians.mean)), axis=-1) < 0
    return product("...ni,n->...ni", normal, jnp.where(away, -1, 1).astype(eye.dtype))
