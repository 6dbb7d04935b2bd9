"""Depth of field of a thin lens: aperture shape, focus and optical vignetting."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.focus_pull import FocusPull, pulled_focus
from gaussray.geometry import normalize
from gaussray.io.plain_values import number, readable, to_device, whole_number
from gaussray.io.validate import check_count, known, require


FOCUS = ("plane", "sphere")


class Rim(eqx.Module):
    """The edge of the front element, which clips oblique rays (optical vignetting).

    A disc parallel to the aperture.

    Args:
        radius: radius in scene units, above 0.
        distance: distance in front of the aperture in scene units, above 0.
    """

    radius: Float[Array, ""] = eqx.field(converter=number("aperture.rim.radius"))
    distance: Float[Array, ""] = eqx.field(converter=number("aperture.rim.distance"))

    def __check_init__(self):
        for key in ("radius", "distance"):
            value = getattr(self, key)
            require(f"aperture.rim.{key}", value, lambda x: np.isfinite(x) & (x > 0), "above 0")

    def __repr__(self) -> str:
        return readable(self)


def _focus_distance(value: Any) -> Any:
    """A focus distance as an array; a `FocusPull` stays what it is."""
    if isinstance(value, FocusPull):
        return value
    return number("aperture.focus_distance")(value)


class Aperture(eqx.Module):
    """The aperture of a thin lens; radius 0 is a pinhole, for which everything is in focus.

    Args:
        radius: radius in scene units, at least 0.
        focus_distance: distance in focus in scene units, above 0, or a `FocusPull`. Infinity is
            allowed.
        rotation: angle in radians, from +x towards up. The edges of the polygon have their middles
            at rotation + 2 pi k / blades.
        ratio: divides the horizontal radius (anamorphic lenses), above 0.
        blades: 0 is a disc, a number from 3 on a regular polygon inscribed in the disc.
        focus: "plane": in focus is the plane at depth `focus_distance`. "sphere": in focus is what
            lies at that distance along the ray, for lenses that see to 90 degrees and beyond.
        rim: a second disc that clips oblique rays; it lies nearer than what is in focus.
        edges: `blades` as a number that a compiled program does not hold (`with_edges`).

    Raises:
        ValueError: If a value breaks its rule; the message names the key.
    """

    radius: Float[Array, ""] = eqx.field(default=0.0, converter=number("aperture.radius"))
    focus_distance: Float[Array, ""] | FocusPull = eqx.field(default=1.0, converter=_focus_distance)
    rotation: Float[Array, ""] = eqx.field(default=0.0, converter=number("aperture.rotation"))
    ratio: Float[Array, ""] = eqx.field(default=1.0, converter=number("aperture.ratio"))
    blades: int = eqx.field(static=True, default=0, converter=whole_number)
    focus: str = eqx.field(static=True, default="plane")
    rim: Rim | None = None
    edges: Float[Array, ""] | None = None

    def __check_init__(self):
        radius, distance = self.radius, _distances(self)
        require("aperture.radius", radius, lambda r: np.isfinite(r) & (r >= 0), "at least 0")
        require("aperture.focus_distance", distance, lambda f: f > 0, "above 0")
        require("aperture.rotation", self.rotation, np.isfinite, "finite")
        require("aperture.ratio", self.ratio, lambda a: np.isfinite(a) & (a > 0), "above 0")
        check_count("aperture.blades", self.blades, 0, "0 is a round aperture.")
        if self.blades in (1, 2):
            raise ValueError(
                f"aperture.blades must be 0 (round) or at least 3 (a polygon), got {self.blades}. "
                "Blender draws 1 and 2 as round: write 0."
            )
        if self.focus not in FOCUS:
            raise ValueError(
                f"aperture.focus must be one of {', '.join(FOCUS)}, got {self.focus!r}."
            )
        if self.rim is not None and known(self.rim.distance, distance):
            nearest = np.min(distance)
            require(
                "aperture.rim.distance",
                self.rim.distance,
                lambda x: x < nearest,
                f"below aperture.focus_distance ({nearest})",
            )

    def __repr__(self) -> str:
        return readable(self)


def with_edges(aperture: Aperture) -> Aperture:
    """The aperture with its number of blades as data, so that apertures of any number of them share
    a compiled program."""
    edges = to_device(aperture.blades, aperture.radius.dtype)
    return dataclasses.replace(aperture, blades=0, edges=edges)


def no_aperture() -> Aperture:
    """An aperture of radius 0, a pinhole: everything is in focus."""
    return Aperture(jnp.zeros(()), jnp.ones(()), jnp.zeros(()), jnp.ones(()))


def focused(aperture: Aperture, time: Float[Array, ""]) -> Aperture:
    """The aperture with one focus distance, that of a time.

    Args:
        aperture: the aperture; without a focus pull it stays as it is.
        time: time of the ray, in the capture's unit.
    """
    return dataclasses.replace(aperture, focus_distance=focus_distance_at(aperture, time))


def focus_distance_at(aperture: Aperture, time: Float[Array, ""]) -> Float[Array, ""]:
    """Focus distance at a time, in scene units.

    Args:
        aperture: the aperture; without a focus pull the distance is that of all times.
        time: time of the ray, in the capture's unit.
    """
    pull = aperture.focus_distance
    if not isinstance(pull, FocusPull):
        return pull
    return pulled_focus(pull, time)


def thin_lens(
    aperture: Aperture, direction: Float[Array, "3"], u: Float[Array, "2"]
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Ray (origin, unit direction) through the point `u` of the aperture, in camera axes.

    All `u` of one pixel meet its chief ray where it is in focus; u = (1/2, 1/2) is the chief ray.
    With focus on a plane the opening lies in the camera's xy plane, on a sphere it is perpendicular
    to the chief ray. The point of focus being f along the ray, the new direction is that of
    `direction - origin/f`: focus at infinity and at 90 degrees (1/f = 0) are ordinary values.
    With a rim, `u` fills what the rim leaves of the opening, and `transmitted` is its weight.

    Args:
        aperture: the aperture, with one focus distance (`focused`).
        direction: unit direction of the chief ray in camera axes; zero gives direction zero.
        u: point of the unit square [0, 1]^2, which is mapped onto the opening with equal areas.
    """
    distance = _distances(aperture)
    offset = aperture.radius * _opening(aperture, direction, u)
    if aperture.focus == "plane":
        origin = jnp.append(offset, 0)
        inverse_distance = direction[2] / distance
    else:
        right, down = _across(direction)
        origin = offset[0] * right + offset[1] * down
        inverse_distance = 1 / distance
    through = normalize(direction - inverse_distance * origin)
    return origin, jnp.where(jnp.any(direction != 0), through, 0)


def transmitted(
    aperture: Aperture, direction: Float[Array, "3"], u: Float[Array, "2"]
) -> Float[Array, ""] | None:
    """Weight of the ray of `thin_lens` with the same `u`; None, which is 1, without a rim.

    Its mean over `u` is the share of the opening that the rim leaves, and the mean of weight times
    light is the light through the whole opening, the lost rays being dark. Both are smooth in
    every parameter where the outline is, and so are their gradients unbiased.

    Args:
        aperture: as for `thin_lens`.
        direction: as for `thin_lens`.
        u: as for `thin_lens`.
    """
    if aperture.rim is None:
        return None
    _, angle = _concentric(u)
    low, high = _kept(aperture, aperture.rim, direction, _outline(aperture, angle))
    return high * high - low * low


def _distances(aperture: Aperture) -> Float[Array, "*knots"]:
    """The distance in focus, or those at the knots of a focus pull."""
    distance = aperture.focus_distance
    return distance.distance if isinstance(distance, FocusPull) else distance


def _opening(
    aperture: Aperture, direction: Float[Array, "3"], u: Float[Array, "2"]
) -> Float[Array, "2"]:
    """Point of what is open of the opening of radius 1, in camera axes (+y down).

    On the way from the middle to a point of the outline, the square of the distance is uniform.
    """
    distance, angle = _concentric(u)
    outline = _outline(aperture, angle)
    if aperture.rim is None:
        return distance * outline
    low, high = _kept(aperture, aperture.rim, direction, outline)
    square = low * low + (high * high - low * low) * distance * distance
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1)), 0) * outline


def _kept(
    aperture: Aperture, rim: Rim, direction: Float[Array, "3"], outline: Float[Array, "2"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Where, as shares of the way from the opening's middle to `outline`, rays pass the rim.

    The ray from the point o of the opening to the point of focus meets the rim's distance L at
    q o + L lean, q = 1 - L/f, from the rim's middle; lean is the tangent of the field angle. On a
    sphere of focus the rim faces the ray as the opening does: lean is the sine and q = 1 - L z/f.
    From 90 degrees on nothing passes.
    """
    z = direction[2]
    ahead = z > 0
    if aperture.focus == "plane":
        lean = direction[:2] / jnp.where(ahead, z, 1)
        shrink = 1 - rim.distance / _distances(aperture)
    else:
        lean = direction[:2]
        shrink = 1 - rim.distance * z / _distances(aperture)
    edge, middle = shrink * aperture.radius * outline, rim.distance * lean
    # |t edge + middle| = radius of the rim
    square, half = jnp.sum(edge * edge), jnp.sum(edge * middle)
    beyond = jnp.sum(middle * middle) - rim.radius**2
    inside = half * half - square * beyond
    crosses = ahead & (inside > 0) & (square > 0)
    root = jnp.sqrt(jnp.where(crosses, inside, 1))
    divisor = jnp.where(crosses, square, 1)
    through_a_point = (ahead & (square == 0) & (beyond < 0)).astype(edge.dtype)
    low = jnp.where(crosses, jnp.clip((-half - root) / divisor, 0, 1), 0)
    high = jnp.where(crosses, jnp.clip((-half + root) / divisor, 0, 1), through_a_point)
    return low, high


def _outline(aperture: Aperture, angle: Float[Array, ""]) -> Float[Array, "2"]:
    """Point of the outline of the opening of radius 1, in camera axes (+y down)."""
    if aperture.edges is not None:
        edges = aperture.edges
        polygon = _polygon(jnp.maximum(edges, 3), aperture.rotation, angle)
        xy = jnp.where(edges < 3, _circle(angle), polygon)
    elif aperture.blades == 0:
        xy = _circle(angle)
    else:
        xy = _polygon(aperture.blades, aperture.rotation, angle)
    return jnp.stack([xy[0] / aperture.ratio, -xy[1]])


def _circle(angle: Float[Array, ""]) -> Float[Array, "2"]:
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)])


def _polygon(
    edges: int | Float[Array, ""], rotation: Float[Array, ""], angle: Float[Array, ""]
) -> Float[Array, "2"]:
    """Point of a regular polygon in the unit circle, y up.

    The disc's angle becomes the way along the polygon's outline. Every edge spans the same triangle
    with the centre, so that equal areas stay equal.
    """
    sector = 2 * jnp.pi / edges
    edge = jnp.floor(angle / sector)
    way = angle / sector - edge
    start = rotation + (edge - 0.5) * sector
    end = start + sector
    return (1 - way) * _circle(start) + way * _circle(end)


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
