"""The pinhole, ideal or with OpenCV's distortion."""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, DTypeLike, Float

from gaussray.camera import distortion as opencv
from gaussray.camera.film import Film
from gaussray.camera.lens.abstract import LensRecord
from gaussray.camera.lens.correctable import ParametricLens
from gaussray.camera.lens.model import (
    LensKeys,
    LensModel,
    LensOptions,
    coefficients_of,
    film_size,
    focal_and_center,
    half_angle,
)
from gaussray.geometry import normalize
from gaussray.io.json_numbers import json_numbers
from gaussray.io.plain_values import to_device, vector
from gaussray.io.validate import known, require


def _distortion(values: Any) -> Array:
    """Coefficients of the distortion; plain numbers may be the first 4 or 5 of them, or none."""
    if isinstance(values, list | tuple):
        values = [*values, *[0.0] * (opencv.COUNTS[0] - len(values))]
    return vector("lens.distortion")(values)


class Pinhole(ParametricLens):
    """Perspective projection with OpenCV's distortion: pixel = center + focal distort(x/z, y/z).

    The formula of the distortion is in `camera/distortion.py`; its inverse is found by Newton's
    method.

    Args:
        focal: focal lengths in pixels, above 0; one number is both.
        center: principal point in pixels.
        distortion: 8, 12 or 14 coefficients in OpenCV's order, without unit (the last two in
            radians); as plain numbers also fewer than 8, the others being 0.
        distorted: whether the coefficients may differ from zero; False computes no distortion. By
            default an array of coefficients may, and plain numbers do if one is not 0.

    Raises:
        ValueError: If a parameter is invalid; the message names the key.
    """

    focal: Float[Array, "2"] = eqx.field(converter=vector("lens.focal", 2, spread=True))
    center: Float[Array, "2"] = eqx.field(converter=vector("lens.center", 2))
    distortion: Float[Array, " coefficients"] = eqx.field(default=(0.0,) * 8, converter=_distortion)
    distorted: bool | None = eqx.field(static=True, default=None)

    fold_message: ClassVar[tuple[str, str]] = (
        "lens.distortion",
        "Coefficients so strong belong to another lens or size of picture, or were never right: "
        "correct them. `gaussray prepare` finds those of photographs and videos.",
    )
    fills_picture: ClassVar[bool] = True

    def __post_init__(self):
        if self.distorted is None:
            plain = isinstance(self.distortion, list | tuple)
            self.distorted = not plain or any(isinstance(k, Array) or k for k in self.distortion)

    @property
    def check_is_complete(self) -> bool:
        return not self.distorted

    @property
    def sees_sideways(self) -> bool:
        return False

    @property
    def coefficient_values(self) -> Float[Array, "*cameras coefficients"]:
        return self.distortion if self.distorted else self.distortion[..., :0]

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        return opencv.COEFFICIENTS[: self.coefficient_values.shape[-1]]

    @property
    def possible_coefficients(self) -> tuple[str, ...]:
        return opencv.COEFFICIENTS

    def with_named_coefficients(self, names: Sequence[str]) -> "Pinhole":
        if not names:
            return self
        required = 1 + max(opencv.COEFFICIENTS.index(name) for name in names)
        present = self.distortion.shape[-1]
        count = next(n for n in opencv.COUNTS if n >= max(required, present))
        padded = jnp.pad(self.distortion, (0, count - present))
        return Pinhole(self.focal, self.center, padded)

    def with_coefficients(self, values: Float[Array, " coefficients"]) -> "Pinhole":
        return dataclasses.replace(self, distortion=values)

    def record(self) -> LensRecord:
        k = dict(zip(opencv.COEFFICIENTS, json_numbers(self.distortion), strict=False))
        used = {key: value for key, value in k.items() if value != 0}
        model = "OPENCV" if used else "PINHOLE"
        return LensRecord({"camera_model": model, **self.intrinsics(), **used})

    def ray(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        if not self.distorted:
            return normalize(jnp.append(xy, 1))
        xy, has_ray = opencv.undistort(self.distortion, xy)
        return jnp.where(has_ray, normalize(jnp.append(xy, 1)), 0)

    def image(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        imaged = point[2] > 0
        xy = point[:2] / jnp.where(imaged, point[2], 1)
        if self.distorted:
            imaged &= opencv.keeps_picture_orientation(self.distortion, xy)
            xy = opencv.distort(self.distortion, xy)
        return xy, imaged

    def check_image(self) -> None:
        count = self.distortion.shape[-1]
        if count not in opencv.COUNTS:
            raise ValueError(
                f"lens.distortion must hold {opencv.COUNTS} coefficients, got {count}."
            )
        require("lens.distortion", self.distortion, np.isfinite, "finite")
        tilt = np.asarray(self.distortion)[..., 12:]
        require("lens.distortion (tilt)", tilt, lambda t: abs(t) < np.pi / 2, "within +-pi/2")
        if not self.distorted:
            remedy = "Build the lens with `pinhole`."
            require("lens.distortion", self.distortion, lambda k: k == 0, "0 here", remedy)


def pinhole(
    focal: Float[Array, "2"],
    center: Float[Array, "2"],
    distortion: Float[Array, " coefficients"] | None = None,
) -> Pinhole:
    """A perspective lens that computes distortion only if a coefficient is not zero, or traced.

    Args:
        focal: focal lengths in pixels.
        center: principal point in pixels.
        distortion: 8, 12 or 14 coefficients in OpenCV's order; None is no distortion.
    """
    if distortion is None:
        return Pinhole(focal, center, to_device(np.zeros(8), focal.dtype), distorted=False)
    if known(distortion) and not np.any(distortion):
        return Pinhole(focal, center, jnp.zeros_like(distortion), distorted=False)
    return Pinhole(focal, center, distortion)


def _from_options(film: Film, options: LensOptions) -> Pinhole:
    if options.fov is None or not options.fov < 180:
        raise ValueError(f"lens.fov must be in (0, 180) for a pinhole, got {options.fov}.")
    k = coefficients_of(options, 0, 4, 5, 8, 12, 14)
    k = np.pad(k, (0, max(8 - len(k), 0)))
    focal = film_size(film)[0] / 2 / np.tan(half_angle(options))
    center = to_device(film_size(film) / 2)
    return pinhole(
        to_device(np.full(2, focal), jnp.float32), center, to_device(k) if any(k) else None
    )


def _from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> Pinhole:
    k = [keys.number(key, 0.0) for key in opencv.COEFFICIENTS]
    # The fewest coefficients that hold all that are not zero.
    count = next(n for n in opencv.COUNTS if not any(k[n:]))
    distortion = to_device(k[:count], dtype) if any(k) else None
    return pinhole(*focal_and_center(keys, dtype), distortion)


MODELS = (
    LensModel(
        name="pinhole",
        label="distortion",
        from_options=_from_options,
        camera_models=(
            *("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"),
        ),
        from_keys=_from_keys,
        frame_keys=opencv.COEFFICIENTS,
        perspective=True,
        option_keys=("fov", "k"),
        widest=150.0,
    ),
)
