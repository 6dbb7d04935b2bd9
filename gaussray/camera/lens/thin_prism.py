"""COLMAP's fisheye with tangential and thin prism distortion."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, DTypeLike, Float

from gaussray.camera.lens.abstract import LensRecord
from gaussray.camera.lens.correctable import ParametricLens
from gaussray.camera.lens.kannala_brandt import monotone_angle
from gaussray.camera.lens.model import LensKeys, LensModel, focal_and_center
from gaussray.camera.lens.radial import axis_angle
from gaussray.camera.roots import jacobian_of, keeps_orientation, plane_root
from gaussray.geometry import safe_norm
from gaussray.io.json_numbers import json_numbers
from gaussray.io.plain_values import number, to_device, vector
from gaussray.io.validate import require


# The coefficients in COLMAP's order.
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "s1", "s2")
# Newton steps, and the largest residual in focal lengths, as in `distortion.py`.
_STEPS, _RESIDUAL = 8, 1e-4


class ThinPrismFisheye(ParametricLens):
    """An equidistant image (x, y) = theta (x, y) / |(x, y)| that is then distorted.

    COLMAP's THIN_PRISM_FISHEYE with coefficients (k1, k2, p1, p2, k3, k4, s1, s2): to x is added
    x (k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) + 2 p1 x y + p2 (theta^2 + 2 x^2) + s1
    theta^2, and likewise to y with p1 and p2 exchanged, and s2. Black beyond `max_angle`.
    """

    focal: Float[Array, "2"] = eqx.field(converter=vector("lens.focal", 2, spread=True))
    center: Float[Array, "2"] = eqx.field(converter=vector("lens.center", 2))
    coefficients: Float[Array, "8"] = eqx.field(converter=vector("lens.k", 8))
    max_angle: Float[Array, ""] = eqx.field(converter=number("lens.max_angle"))

    @property
    def sees_sideways(self) -> bool:
        return float(self.max_angle) >= np.pi / 2

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        return _COEFFICIENTS

    def record(self) -> LensRecord:
        k = dict(zip(_COEFFICIENTS, json_numbers(self.coefficients), strict=True))
        block = {"model": "thin_prism_fisheye", "fov": json_numbers(2 * self.max_angle)}
        keys = {"camera_model": "THIN_PRISM_FISHEYE", **self.intrinsics(), **k}
        return LensRecord({**keys, "lens": block})

    def ray(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        start = jax.lax.stop_gradient(xy)
        plain, has_ray = plane_root(
            _distorted, xy, self.coefficients, start, steps=_STEPS, residual=_RESIDUAL
        )
        theta = safe_norm(plain)
        has_ray &= theta <= self.max_angle
        return jnp.where(has_ray, jnp.append(jnp.sinc(theta / jnp.pi) * plain, jnp.cos(theta)), 0)

    def image(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        theta, axial, off_axis = axis_angle(point)
        imaged = (theta <= self.max_angle) & (off_axis | (point[2] > 0))
        limit = 1 / jnp.where(off_axis | (point[2] == 0), 1, point[2])
        stretch = jnp.where(off_axis, theta / axial, limit)
        plain = jnp.where(imaged, stretch * point[:2], 0)
        imaged &= keeps_orientation(jacobian_of(_distorted)(plain, self.coefficients))
        return _distorted(plain, self.coefficients), imaged

    def check_image(self) -> None:
        require("lens.k", self.coefficients, np.isfinite, "finite")
        most = np.pi * (1 + 1e-6)
        require("lens.max_angle", self.max_angle, lambda a: (a > 0) & (a <= most), "in (0, pi]")


def _distorted(xy: Float[Array, "2"], coefficients: Float[Array, "8"]) -> Float[Array, "2"]:
    k1, k2, p1, p2, k3, k4, s1, s2 = coefficients
    x, y = xy
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))
    return jnp.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x) + s1 * square,
            y * radial + 2 * p2 * x * y + p1 * (square + 2 * y * y) + s2 * square,
        ]
    )


def _from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> ThinPrismFisheye:
    k = [keys.number(key, 0.0) for key in _COEFFICIENTS]
    radial = k[0], k[1], k[4], k[5]
    half = block.number("fov") / 2 if block.has("fov") else monotone_angle(radial)
    arrays = to_device(k, dtype), to_device(half, dtype)
    return ThinPrismFisheye(*focal_and_center(keys, dtype), *arrays)


MODELS = (
    LensModel(
        block="thin_prism_fisheye",
        camera_models=("THIN_PRISM_FISHEYE",),
        from_keys=_from_keys,
        frame_keys=_COEFFICIENTS,
        block_keys=("fov",),
    ),
)
