"""Lenses that bend rays by their angle from the optical axis alone."""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, DTypeLike, Float

from gaussray.camera.film import Film
from gaussray.camera.lens.abstract import LensRecord
from gaussray.camera.lens.correctable import ParametricLens
from gaussray.camera.lens.model import (
    LensKeys,
    LensOptions,
    film_size,
    focal_and_center,
    half_angle,
    half_crop,
)
from gaussray.geometry import safe_norm
from gaussray.io.json_numbers import json_numbers
from gaussray.io.plain_values import to_device
from gaussray.io.validate import require


class RadialLens(ParametricLens):
    """pixel = center + focal r(theta) (x, y) / |(x, y)|, theta the angle from the optical axis.

    `max_angle` is the half angle of view: r(theta) must increase up to it, and the picture is black
    beyond it. No azimuth is formed, so that the axis is an ordinary place.
    """

    max_angle: eqx.AbstractVar[Float[Array, ""]]

    @abc.abstractmethod
    def radius(self, theta: Float[Array, ""]) -> Float[Array, ""]:
        """r(theta) for theta in [0, max_angle]; r(0) = 0."""

    @abc.abstractmethod
    def angle(self, r: Float[Array, ""]) -> Float[Array, ""]:
        """theta(r) for r in [0, r(max_angle)]."""

    @abc.abstractmethod
    def slope(self) -> Float[Array, ""]:
        """dr/dtheta on the axis."""

    @property
    def check_is_complete(self) -> bool:
        return True

    @property
    def sees_sideways(self) -> bool:
        return float(self.max_angle) >= np.pi / 2

    def axis_slope(self) -> Float[Array, ""] | float:
        return self.slope()

    def block_record(self, model: str, values: Mapping[str, Any]) -> LensRecord:
        """The record of a lens with a `lens` block.

        Args:
            model: `model` of the block.
            values: its other values, in this order.
        """
        numbers = {key: x if isinstance(x, str) else json_numbers(x) for key, x in values.items()}
        return LensRecord({**self.intrinsics(), "lens": {"model": model, **numbers}})

    def ray(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        r = safe_norm(xy)
        lit = r <= self.radius(self.max_angle)
        theta = self.angle(jnp.where(lit, r, 0))
        off_axis = r > 0
        stretch = jnp.sin(theta) / jnp.where(off_axis, r, 1)
        stretch = jnp.where(off_axis, stretch, 1 / self.slope())
        return jnp.where(lit, jnp.append(stretch * xy, jnp.cos(theta)), 0)

    def image(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        theta, axial, off_axis = axis_angle(point)
        # What lies straight behind has no side of the picture.
        imaged = (theta <= self.max_angle) & (off_axis | (point[2] > 0))
        r = self.radius(jnp.where(imaged, theta, 0))
        limit = self.slope() / jnp.where(off_axis | (point[2] == 0), 1, point[2])
        return jnp.where(off_axis, r / axial, limit) * point[:2], imaged

    def check_radial(self, widest: float = np.pi, key: str = "lens.k") -> None:
        """Check that `max_angle` is at most `widest` and that r(theta) increases up to it.

        Args:
            widest: largest half angle of view, in radians.
            key: the parameter that the message names if r(theta) turns back.

        Raises:
            ValueError: One of both does not hold.
        """
        angle = self.max_angle
        rule = "in (0, pi]" if widest == np.pi else f"in (0, {widest:.7g}]"
        # Half angles come in single precision.
        most = widest * (1 + 1e-6)
        require("lens.max_angle", angle, lambda a: (a > 0) & (a <= most), f"{rule} here")
        r = np.asarray(jax.vmap(self.radius)(jnp.linspace(0, angle, 257)))
        if not np.all(np.diff(r) > 0):
            raise ValueError(
                f"{key} must be monotone: r(theta) may not turn back within half of the field of "
                f"view, {float(angle):.4g} radians, got {self._shape()}. Lower lens.fov (or "
                "lens.crop), or use weaker coefficients."
            )

    def _shape(self) -> list[float]:
        return np.asarray(getattr(self, "coefficients", ())).tolist()


_Radial = TypeVar("_Radial", bound=RadialLens)


def axis_angle(
    point: Float[Array, "3"],
) -> tuple[Float[Array, ""], Float[Array, ""], Bool[Array, ""]]:
    """Angle of a point from the optical axis, its distance from the axis (1 on it), and whether it
    lies off the axis."""
    distance = safe_norm(point[:2])
    off_axis = distance > 0
    axial = jnp.where(off_axis, distance, 1)
    on_axis_angle = jnp.where(point[2] < 0, jnp.pi, 0).astype(point.dtype)
    return jnp.where(off_axis, jnp.arctan2(axial, point[2]), on_axis_angle), axial, off_axis


def safe_sqrt(square: Float[Array, ""]) -> Float[Array, ""]:
    """Square root that is 0, with gradient 0, for numbers of at most 0.

    Rounding can make such a number negative at the rim of a lens, where the gradient of the plain
    square root is infinite.
    """
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1)), 0)


def lens_of_options(
    film: Film,
    options: LensOptions,
    lens: Callable[..., _Radial],
    *parameters: Float[np.ndarray, " coefficients"],
    widest: float = 180.0,
) -> _Radial:
    """A radial lens of the user's options.

    `lens.fov` spans the smaller side of the film; beyond `lens.crop` the picture is black.

    Args:
        film: size of the picture.
        options: the user's options, of which `fov` and `crop` are read.
        lens: builds the lens from focal lengths, principal point, `parameters` and half angle.
        parameters: further arrays of the lens.
        widest: largest half angle of view, in degrees.
    """
    center = to_device(film_size(film) / 2)
    angle, crop = (to_device(f(options, widest), jnp.float32) for f in (half_angle, half_crop))
    arrays = [to_device(values, jnp.float32) for values in parameters]

    def scaled(focal: float, half: Array) -> _Radial:
        return lens(to_device(np.full(2, focal), jnp.float32), center, *arrays, half)

    return scaled(float(film_size(film).min() / 2 / scaled(1.0, angle).radius(angle)), crop)


def lens_of_keys(
    lens: Callable[..., _Radial],
    keys: LensKeys,
    dtype: DTypeLike,
    *parameters: float | Sequence[float],
) -> _Radial:
    """A radial lens of a frame's keys.

    Args:
        lens: builds the lens from focal lengths, principal point and `parameters`.
        keys: keys of the frame, with focal lengths and principal point.
        dtype: precision of the arrays.
        parameters: further numbers of the lens; the last is the half angle of view in radians.
    """
    arrays = (to_device(values, dtype) for values in parameters)
    return lens(*focal_and_center(keys, dtype), *arrays)
