"""Kannala and Brandt's fisheye, as OpenCV has it."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.film import Film
from gaussray.camera.lens.abstract import LensRecord
from gaussray.camera.lens.model import LensKeys, LensModel, LensOptions, coefficients_of
from gaussray.camera.lens.radial import RadialLens, lens_of_keys, lens_of_options
from gaussray.camera.roots import increasing_root
from gaussray.io.json_numbers import json_numbers
from gaussray.io.plain_values import number, vector
from gaussray.io.validate import require


class KannalaBrandt(RadialLens):
    """r(theta) = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), in focal lengths.

    OpenCV's fisheye (Kannala and Brandt 2006). theta(r) is found by bisection and Newton's method.

    Args:
        focal: focal lengths in pixels, above 0.
        center: principal point in pixels.
        coefficients: k1, k2, k3, k4.
        max_angle: half of the field of view in radians, at most pi; r must increase up to it.

    Raises:
        ValueError: If a parameter is invalid; the message names the key.
    """

    focal: Float[Array, "2"] = eqx.field(converter=vector("lens.focal", 2, spread=True))
    center: Float[Array, "2"] = eqx.field(converter=vector("lens.center", 2))
    coefficients: Float[Array, "4"] = eqx.field(converter=vector("lens.k", 4))
    max_angle: Float[Array, ""] = eqx.field(converter=number("lens.max_angle"))

    def radius(self, theta: Float[Array, ""]) -> Float[Array, ""]:
        return _radius(theta, self.coefficients)

    def angle(self, r: Float[Array, ""]) -> Float[Array, ""]:
        return increasing_root(_radius, r, self.coefficients, self.max_angle)

    def slope(self) -> Float[Array, ""]:
        return jnp.ones_like(self.max_angle)

    def check_image(self) -> None:
        require("lens.k", self.coefficients, np.isfinite, "finite")
        self.check_radial()

    def record(self) -> LensRecord:
        k = dict(zip(_FRAME_KEYS, json_numbers(self.coefficients), strict=True))
        block = {"model": "kannala_brandt", "fov": json_numbers(2 * self.max_angle)}
        keys = {"camera_model": "OPENCV_FISHEYE", **self.intrinsics(), **k}
        return LensRecord({**keys, "lens": block})


def monotone_angle(k: Sequence[float]) -> float:
    """Half angle, in radians, up to which theta (1 + k1 theta^2 + ... + k4 theta^8) increases.

    It is at most pi, and serves as the field of view of a file that names none.
    """
    theta = np.linspace(0, np.pi, 4097)
    slope = np.polynomial.polynomial.polyval(theta**2, [1, *np.multiply(k, (3, 5, 7, 9))])
    falls = slope <= 1e-3
    return 0.9999 * (theta[int(np.argmax(falls))] if falls.any() else np.pi)


def _radius(theta: Float[Array, ""], k: Float[Array, "4"]) -> Float[Array, ""]:
    square = theta * theta
    return theta * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))


def _from_options(film: Film, options: LensOptions) -> KannalaBrandt:
    return lens_of_options(film, options, KannalaBrandt, coefficients_of(options, 4))


def _from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> KannalaBrandt:
    k = [keys.number(key, 0.0) for key in _FRAME_KEYS]
    half = block.number("fov") / 2 if block.has("fov") else monotone_angle(k)
    return lens_of_keys(KannalaBrandt, keys, dtype, k, half)


_FRAME_KEYS = ("k1", "k2", "k3", "k4")
MODELS = (
    LensModel(
        name="kannala_brandt",
        from_options=_from_options,
        block="kannala_brandt",
        camera_models=("OPENCV_FISHEYE",),
        from_keys=_from_keys,
        frame_keys=_FRAME_KEYS,
        block_keys=("fov",),
    ),
)
