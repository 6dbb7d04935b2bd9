"""What every lens is: a map between pixels and viewing directions.

Camera axes are +x right, +y down, +z forward. Pixels are (column, row), their centres at +0.5.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.camera.validate import known, require


class AbstractLens(eqx.Module):
    """A map between pixels and viewing directions, each the other's inverse."""

    @abc.abstractmethod
    def direction(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        """Unit viewing direction of a pixel; zero where the lens forms no ray."""

    @abc.abstractmethod
    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        """Pixel of a point in camera axes, at any distance; NaN where it is not imaged."""

    @abc.abstractmethod
    def check(self) -> None:
        """Raise a ValueError that names the parameter which makes no lens."""

    def __check_init__(self):
        if known(*jax.tree.leaves(self)):
            # Also where a lens of known numbers is built inside `jit`.
            with jax.ensure_compile_time_eval():
                self.check()

    def sees(self, pixel: Float[Array, "2"]) -> Bool[Array, ""]:
        """Whether the lens forms a ray for this pixel."""
        return jnp.any(self.direction(pixel) != 0)


class FocalLens(AbstractLens):
    """A lens whose picture is scaled about a point: pixel = center + focal * image.

    Cutting and scaling its picture changes `focal` and `center` alone. What the length of 1 in the
    image means is each lens's own.
    """

    focal: eqx.AbstractVar[Float[Array, "2"]]
    center: eqx.AbstractVar[Float[Array, "2"]]

    @abc.abstractmethod
    def ray(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        """Unit viewing direction of an image point; zero where the lens forms no ray."""

    @abc.abstractmethod
    def image(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        """Image point of a point in camera axes (finite in any case), and whether it is imaged."""

    @abc.abstractmethod
    def check_image(self) -> None:
        """`check` of all that is not `focal` and `center`."""

    def direction(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        return self.ray((pixel - self.center) / self.focal)

    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        xy, imaged = self.image(point)
        return jnp.where(imaged, self.center + self.focal * xy, jnp.nan)

    def check(self) -> None:
        require("lens.focal", self.focal, lambda f: np.isfinite(f) & (f > 0), "above 0")
        require("lens.center", self.center, np.isfinite, "finite")
        self.check_image()
