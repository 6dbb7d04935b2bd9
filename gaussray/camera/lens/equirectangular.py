"""The equirectangular projection of the sphere or a part of it."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, DTypeLike, Float

from gaussray.camera.film import Film
from gaussray.camera.lens.abstract import FocalLens, LensRecord
from gaussray.camera.lens.model import (
    LensKeys,
    LensModel,
    LensOptions,
    coefficients_of,
    film_size,
    focal_and_center,
    half_angle,
)
from gaussray.geometry import safe_norm
from gaussray.io.plain_values import to_device, vector


class Equirectangular(FocalLens):
    """pixel = center + focal (longitude, latitude downwards) / pi; (0, 0) looks along +z.

    `focal` is in pixels per half turn, as nerfstudio's: (width / 2, height) and `center` in the
    middle are the whole sphere; larger ones are a part of it. Points come back with a longitude in
    (-pi, pi], those straight up and down with longitude 0. Beyond its edges the picture goes on
    around the sphere.
    """

    focal: Float[Array, "2"] = eqx.field(converter=vector("lens.focal", 2, spread=True))
    center: Float[Array, "2"] = eqx.field(converter=vector("lens.center", 2))

    fold_message: ClassVar[tuple[str, str]] = (
        "lens.focal",
        "No picture holds more than 360 by 180 degrees of the sphere.",
    )

    @property
    def sees_sideways(self) -> bool:
        return True

    def record(self) -> LensRecord:
        return LensRecord({"camera_model": "EQUIRECTANGULAR", **self.intrinsics()})

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
        """Any focal length is a lens; `check_span` refuses pictures of more than the sphere."""


def _from_options(film: Film, options: LensOptions) -> Equirectangular:
    coefficients_of(options, 0)
    if not 0 < options.fov_y <= 180:
        raise ValueError(f"lens.fov_y must be in (0, 180] degrees, got {options.fov_y}.")
    size, half = film_size(film), np.rad2deg(half_angle(options))
    focal = size * 180 / np.array([2 * half, options.fov_y], np.float32)
    return Equirectangular(to_device(focal, jnp.float32), to_device(size / 2))


def _from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> Equirectangular:
    return Equirectangular(*focal_and_center(keys, dtype))


MODELS = (
    LensModel(
        name="equirectangular",
        label="equirectangular",
        from_options=_from_options,
        block="equirectangular",
        camera_models=("EQUIRECTANGULAR",),
        from_keys=_from_keys,
        option_keys=("fov", "fov_y"),
    ),
)
