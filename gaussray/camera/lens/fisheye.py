"""Fisheye lenses of the four classical projections."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.film import Film
from gaussray.camera.lens.abstract import LensRecord
from gaussray.camera.lens.model import LensKeys, LensModel, LensOptions, coefficients_of
from gaussray.camera.lens.radial import RadialLens, lens_of_keys, lens_of_options, safe_sqrt
from gaussray.io.plain_values import number, vector


# Name -> largest half angle of view. Stereographic, what lies straight behind is infinitely far.
PROJECTIONS = {
    "equidistant": np.pi,
    "equisolid": np.pi,
    "stereographic": 0.99 * np.pi,
    "orthographic": np.pi / 2,
}


class Fisheye(RadialLens):
    """A fisheye with r(theta) in closed form both ways, r in focal lengths.

    equidistant: r = theta (angles are to scale). equisolid: r = 2 sin(theta/2) (solid angles are to
    scale, as in most photographic fisheyes). stereographic: r = 2 tan(theta/2) (conformal).
    orthographic: r = sin(theta) (at most 180 degrees; at the rim dtheta/dr is infinite, and the
    gradient there is 0 instead).

    Args:
        focal: focal lengths in pixels, above 0.
        center: principal point in pixels.
        max_angle: half of the field of view in radians; the picture is black beyond it.
        projection: one of `PROJECTIONS`.

    Raises:
        ValueError: If a parameter is invalid; the message names the key.
    """

    focal: Float[Array, "2"] = eqx.field(converter=vector("lens.focal", 2, spread=True))
    center: Float[Array, "2"] = eqx.field(converter=vector("lens.center", 2))
    max_angle: Float[Array, ""] = eqx.field(converter=number("lens.max_angle"))
    projection: str = eqx.field(static=True, default="equidistant")

    def radius(self, theta: Float[Array, ""]) -> Float[Array, ""]:
        match self.projection:
            case "equisolid":
                return 2 * jnp.sin(theta / 2)
            case "stereographic":
                return 2 * jnp.tan(theta / 2)
            case "orthographic":
                # Rounding may take half angles beyond 90 degrees, where the sine turns back.
                return jnp.sin(jnp.minimum(theta, np.pi / 2))
            case _:
                return theta

    def angle(self, r: Float[Array, ""]) -> Float[Array, ""]:
        match self.projection:
            case "equisolid":
                # Squares of differences, not differences of squares: exact up to the rim.
                return 2 * jnp.arctan2(r / 2, safe_sqrt((1 - r / 2) * (1 + r / 2)))
            case "stereographic":
                return 2 * jnp.arctan2(r, jnp.full_like(r, 2))
            case "orthographic":
                return jnp.arctan2(r, safe_sqrt((1 - r) * (1 + r)))
            case _:
                return r

    def slope(self) -> Float[Array, ""]:
        return jnp.ones_like(self.max_angle)

    def check_image(self) -> None:
        if self.projection not in PROJECTIONS:
            raise ValueError(
                f"lens.model must be one of {', '.join(PROJECTIONS)}, got {self.projection!r}."
            )
        self.check_radial(PROJECTIONS[self.projection], "lens.max_angle")

    def record(self) -> LensRecord:
        return self.block_record(self.projection, {"fov": 2 * self.max_angle})


def _from_options(film: Film, options: LensOptions) -> Fisheye:
    coefficients_of(options, 0)
    lens = functools.partial(Fisheye, projection=options.model)
    return lens_of_options(film, options, lens, widest=np.rad2deg(PROJECTIONS[options.model]))


def _from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> Fisheye:
    lens = functools.partial(Fisheye, projection=block.text("model"))
    return lens_of_keys(lens, keys, dtype, block.number("fov") / 2)


# The viewer stops short of the largest stereographic field, whose rim is nearly at infinity.
_WIDEST = {"stereographic": 350.0, "orthographic": 180.0}
MODELS = tuple(
    LensModel(
        name=name,
        from_options=_from_options,
        block=name,
        from_keys=_from_keys,
        block_keys=("fov",),
        option_keys=("fov", "crop"),
        widest=_WIDEST.get(name, 360.0),
    )
    for name in PROJECTIONS
)
