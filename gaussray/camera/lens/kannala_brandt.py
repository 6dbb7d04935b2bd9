"""Kannala and Brandt's fisheye, as OpenCV has it."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.lens.radial import RadialLens
from gaussray.camera.roots import increasing_root
from gaussray.camera.validate import require


class KannalaBrandt(RadialLens):
    """r(theta) = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), in focal lengths.

    OpenCV's fisheye (Kannala and Brandt 2006). Its inverse is found by bisection and Newton.
    """

    focal: Float[Array, "2"]
    center: Float[Array, "2"]
    coefficients: Float[Array, "4"]
    max_angle: Float[Array, ""]

    def radius(self, theta: Float[Array, ""]) -> Float[Array, ""]:
        return _radius(theta, self.coefficients)

    def angle(self, r: Float[Array, ""]) -> Float[Array, ""]:
        return increasing_root(_radius, r, self.coefficients, self.max_angle)

    def slope(self) -> Float[Array, ""]:
        return jnp.ones_like(self.max_angle)

    def check_image(self) -> None:
        require("lens.k", self.coefficients, np.isfinite, "finite")
        self.check_radial()


def _radius(theta: Float[Array, ""], k: Float[Array, "4"]) -> Float[Array, ""]:
    square = theta * theta
    return theta * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))
