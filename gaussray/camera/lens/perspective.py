"""The pinhole, ideal or with OpenCV's distortion."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.camera.distortion import COUNTS, distort, undistort, unfolded
from gaussray.camera.lens.abstract import FocalLens
from gaussray.camera.validate import known, require
from gaussray.geometry import normalize


class Pinhole(FocalLens):
    """Perspective: pixel = center + focal (x/z, y/z), distorted as by OpenCV (`distortion.py`).

    `distorted` says whether the coefficients (8, 12 or 14) can differ from zero; an ideal pinhole
    without it pays nothing for them. `pinhole` decides that.
    """

    focal: Float[Array, "2"]
    center: Float[Array, "2"]
    distortion: Float[Array, " coefficients"]
    distorted: bool = eqx.field(static=True, default=True)

    def ray(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        if not self.distorted:
            return normalize(jnp.append(xy, 1))
        xy, found = undistort(self.distortion, xy)
        return jnp.where(found, normalize(jnp.append(xy, 1)), 0)

    def image(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        imaged = point[2] > 0
        xy = point[:2] / jnp.where(imaged, point[2], 1)
        if self.distorted:
            imaged &= unfolded(self.distortion, xy)
            xy = distort(self.distortion, xy)
        return xy, imaged

    def check_image(self) -> None:
        count = self.distortion.shape[-1]
        if count not in COUNTS:
            raise ValueError(f"lens.distortion must hold {COUNTS} coefficients, got {count}.")
        require("lens.distortion", self.distortion, np.isfinite, "finite")
        tilt = self.distortion[..., 12:]
        require("lens.distortion (tilt)", tilt, lambda t: abs(t) < np.pi / 2, "within +-pi/2")
        if not self.distorted:
            remedy = "Build the lens with `pinhole`."
            require("lens.distortion", self.distortion, lambda k: k == 0, "0 here", remedy)


def pinhole(
    focal: Float[Array, "2"],
    center: Float[Array, "2"],
    distortion: Float[Array, " coefficients"] | None = None,
) -> Pinhole:
    """Perspective lens that pays for distortion only if there is some (or if it is traced)."""
    if distortion is None:
        return Pinhole(focal, center, jnp.zeros(8, focal.dtype), distorted=False)
    if known(distortion) and not np.any(distortion):
        return Pinhole(focal, center, jnp.zeros_like(distortion), distorted=False)
    return Pinhole(focal, center, distortion)
