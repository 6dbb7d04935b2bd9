"""COLMAP's fisheye with tangential and thin prism distortion."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.camera.lens.abstract import FocalLens
from gaussray.camera.lens.radial import polar
from gaussray.camera.roots import keeps_orientation, plane_root
from gaussray.camera.validate import require
from gaussray.geometry import safe_norm


# The coefficients in COLMAP's order.
NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "s1", "s2")
# Newton steps, and the largest residual in focal lengths, as in `distortion.py`.
STEPS, RESIDUAL = 8, 1e-4


class ThinPrismFisheye(FocalLens):
    """An equidistant image (x, y) = theta (x, y) / |(x, y)| that is then distorted.

    COLMAP's THIN_PRISM_FISHEYE with coefficients (k1, k2, p1, p2, k3, k4, s1, s2): to x is added
    x (k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) + 2 p1 x y + p2 (theta^2 + 2 x^2) + s1
    theta^2, and likewise to y with p1 and p2 exchanged, and s2. Black beyond `max_angle`.
    """

    focal: Float[Array, "2"]
    center: Float[Array, "2"]
    coefficients: Float[Array, "8"]
    max_angle: Float[Array, ""]

    def ray(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        start = jax.lax.stop_gradient(xy)
        plain, found = plane_root(
            _distorted, xy, self.coefficients, start, steps=STEPS, residual=RESIDUAL
        )
        theta = safe_norm(plain)
        found &= theta <= self.max_angle
        return jnp.where(found, jnp.append(jnp.sinc(theta / jnp.pi) * plain, jnp.cos(theta)), 0)

    def image(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        theta, axial, off_axis = polar(point)
        imaged = (theta <= self.max_angle) & (off_axis | (point[2] > 0))
        limit = 1 / jnp.where(off_axis | (point[2] == 0), 1, point[2])
        stretch = jnp.where(off_axis, theta / axial, limit)
        plain = jnp.where(imaged, stretch * point[:2], 0)
        imaged &= keeps_orientation(_distorted, plain, self.coefficients)
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
