"""Depth of field: light enters through an opening instead of a point."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.checks import require
from gaussray.geometry import normalize


FOCUS = ("plane", "sphere")


class Aperture(eqx.Module):
    """Opening of a thin lens, in scene units; `radius = 0` is a pinhole.

    Fewer than 3 `blades` is a disc, otherwise a regular polygon inscribed in it, whose edges have
    their middles at `rotation` + 2 pi k / blades from +x towards up. `ratio` divides the x radius
    (anamorphic). Sharp is the plane at depth `focus_distance`, or with `focus = "sphere"` what lies
    that far along the ray, for lenses that see to 90 degrees and beyond. Infinity is legal.
    """

    radius: Float[Array, ""]
    focus_distance: Float[Array, ""]
    rotation: Float[Array, ""]
    ratio: Float[Array, ""]
    blades: int = eqx.field(static=True, default=0)
    focus: str = eqx.field(static=True, default="plane")

    def __check_init__(self):
        radius, distance = self.radius, self.focus_distance
        require("aperture.radius", radius, lambda r: np.isfinite(r) & (r >= 0), "at least 0")
        require("aperture.focus_distance", distance, lambda f: f > 0, "above 0")
        require("aperture.rotation", self.rotation, np.isfinite, "finite")
        require("aperture.ratio", self.ratio, lambda a: np.isfinite(a) & (a > 0), "above 0")
        if self.blades < 0:
            raise ValueError(
                f"aperture.blades must be at least 0, got {self.blades}. 0 is a round aperture."
            )
        if self.focus not in FOCUS:
            raise ValueError(f"aperture.focus must be one of {FOCUS}, got {self.focus!r}.")


def no_aperture() -> Aperture:
    """The pinhole: everything is sharp."""
    return Aperture(jnp.zeros(()), jnp.ones(()), jnp.zeros(()), jnp.ones(()))


def thin_lens(
    aperture: Aperture, direction: Float[Array, "3"], u: Float[Array, "2"]
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Ray (origin, unit direction) through the point `u` of the aperture, in camera axes.

    All `u` of one pixel meet its chief ray where it is in focus; u = (1/2, 1/2) is the chief ray.
    With focus on a plane the opening lies in the camera's xy plane, on a sphere it is perpendicular
    to the chief ray. The point of focus being f along the ray, the new direction is that of
    `direction - origin/f`: focus at infinity and at 90 degrees (1/f = 0) are ordinary values.
    """
    offset = aperture.radius * _opening(aperture, u)
    if aperture.focus == "plane":
        origin = jnp.append(offset, 0)
        inverse_distance = direction[2] / aperture.focus_distance
    else:
        right, down = _across(direction)
        origin = offset[0] * right + offset[1] * down
        inverse_distance = 1 / aperture.focus_distance
    through = normalize(direction - inverse_distance * origin)
    return origin, jnp.where(jnp.any(direction != 0), through, 0)


def _opening(aperture: Aperture, u: Float[Array, "2"]) -> Float[Array, "2"]:
    """Point of the opening of radius 1, uniform by area, in camera axes (+y down)."""
    distance, angle = _concentric(u)
    if aperture.blades < 3:
        xy = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    else:
        # The disc's angle becomes the way along the polygon's outline. Every edge spans the same
        # triangle with the centre, so that equal areas stay equal.
        sector = 2 * jnp.pi / aperture.blades
        edge = jnp.floor(angle / sector)
        way = angle / sector - edge
        start = aperture.rotation + (edge - 0.5) * sector
        end = start + sector
        xy = (1 - way) * jnp.stack([jnp.cos(start), jnp.sin(start)])
        xy = xy + way * jnp.stack([jnp.cos(end), jnp.sin(end)])
    return distance * jnp.stack([xy[0] / aperture.ratio, -xy[1]])


def _concentric(u: Float[Array, "2"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Distance from the centre and angle of a uniform point of the unit disc.

    Squares around the centre of [0, 1]^2 become circles (Shirley and Chiu 1997), which keeps
    well-spread samples well spread.
    """
    x, y = 2 * u - 1
    sideways = jnp.abs(x) > jnp.abs(y)
    longer, shorter = jnp.where(sideways, x, y), jnp.where(sideways, y, x)
    lean = jnp.pi / 4 * shorter / jnp.where(longer == 0, 1, longer)
    angle = jnp.where(sideways, lean, jnp.pi / 2 - lean)
    return jnp.abs(longer), jnp.where(longer < 0, angle + jnp.pi, angle)


def _across(direction: Float[Array, "3"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """The camera's x and y axes after the shortest turn that takes its z axis to `direction`."""
    x, y, z = direction
    # Straight backwards there is no shortest turn; x = y = 0 there makes any divisor do.
    divisor = jnp.where(z > -1, 1 + z, 1)
    shear = -x * y / divisor
    right = jnp.stack([1 - x * x / divisor, shear, -x])
    down = jnp.stack([shear, 1 - y * y / divisor, -y])
    return right, down
