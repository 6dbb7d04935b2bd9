"""Surface normals of Gaussians."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.geometry import product, rotation_matrix
from gaussray.scene.gaussians import Gaussians


def normals(gaussians: Gaussians, eye: Float[Array, "3"]) -> Float[Array, "*keys n 3"]:
    """Unit normal of every Gaussian: its shortest principal axis, on the side of the camera.

    It is meaningful for flat Gaussians only. With key states, axis and side are those of the middle
    one, so that the normal changes smoothly from key to key.

    Args:
        gaussians: the Gaussians.
        eye: position of the camera, in scene units.
    """

    def middle(x: Array) -> Array:
        return x[x.shape[0] // 2] if x.ndim == 3 else x

    axis = jax.nn.one_hot(jnp.argmin(middle(gaussians.scale), axis=-1), 3, dtype=eye.dtype)
    normal = product("...nij,nj->...ni", rotation_matrix(gaussians.quat), axis)
    turned_away = jnp.sum(middle(normal) * (eye[None] - middle(gaussians.mean)), axis=-1) < 0
    return product("...ni,n->...ni", normal, jnp.where(turned_away, -1, 1).astype(eye.dtype))
