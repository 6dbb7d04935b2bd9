"""The whole sphere, or a part of it, by longitude and latitude."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaussray.camera.lens.abstract import FocalLens
from gaussray.geometry import safe_norm


class Equirectangular(FocalLens):
    """pixel = center + focal (longitude, latitude downwards) / pi; (0, 0) looks along +z.

    `focal` is in pixels per half turn, as nerfstudio's: (width / 2, height) and `center` in the
    middle are the whole sphere; larger ones are a part of it. Points come back with a longitude in
    (-pi, pi], those straight up and down with longitude 0. Beyond its edges the picture goes on
    around the sphere.
    """

    focal: Float[Array, "2"]
    center: Float[Array, "2"]

    def ray(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        longitude, latitude = jnp.pi * xy
        flat = jnp.cos(latitude)
        return jnp.stack([flat * jnp.sin(longitude), jnp.sin(latitude), flat * jnp.cos(longitude)])

    def image(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        x, y, z = point
        flat = safe_norm(jnp.stack([x, z]))
        # At the poles longitude has no value, and neither has its gradient.
        polar = flat == 0
        longitude = jnp.where(polar, 0, jnp.arctan2(x, jnp.where(polar, 1, z)))
        imaged = jnp.any(point != 0)
        latitude = jnp.arctan2(y, jnp.where(imaged, flat, 1))
        return jnp.stack([longitude, latitude]) / jnp.pi, imaged

    def check_image(self) -> None:
        """Any focal length is a lens; `check_lens` refuses pictures of more than the sphere."""
