"""Blender's fisheye, as a polynomial of the distance on the sensor."""

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.film import Film
from gaussray.camera.lens.abstract import AbstractLens, LensRecord
from gaussray.camera.lens.correctable import CorrectableLens
from gaussray.camera.lens.model import (
    LensKeys,
    LensModel,
    LensOptions,
    coefficients_of,
    film_size,
    half_angle,
    half_crop,
)
from gaussray.camera.lens.radial import axis_angle
from gaussray.camera.roots import increasing_root
from gaussray.geometry import safe_norm
from gaussray.io.json_numbers import json_numbers
from gaussray.io.plain_values import number, to_device, vector
from gaussray.io.validate import require


class FisheyePolynomial(CorrectableLens):
    """Blender's FISHEYE_LENS_POLYNOMIAL: theta = -(k0 + k1 r + k2 r^2 + k3 r^3 + k4 r^4).

    r is the distance on the sensor in millimetres, theta the angle from the axis in radians;
    ordinary lenses have negative k1, and a negative theta looks to the opposite side (a picture
    mirrored through its centre). `sensor` is (width, height) in mm, `resolution` the same picture
    in pixels, `shift` Blender's (fractions of the sensor, +x right, +y up). Beyond `fov`/2 it is
    black.
    """

    coefficients: Float[Array, "5"] = eqx.field(converter=vector("lens.k", 5))
    sensor: Float[Array, "2"] = eqx.field(converter=vector("lens.sensor", 2))
    resolution: Float[Array, "2"] = eqx.field(converter=vector("lens.resolution", 2))
    shift: Float[Array, "2"] = eqx.field(converter=vector("lens.shift", 2))
    fov: Float[Array, ""] = eqx.field(converter=number("lens.fov"))

    focal_unit: ClassVar[str] = "mm"
    center_unit: ClassVar[str] = "sensor"
    linear_coefficient: ClassVar[int | None] = 1

    @property
    def check_is_complete(self) -> bool:
        return True

    @property
    def sees_sideways(self) -> bool:
        return float(self.fov) >= np.pi

    @property
    def coefficient_values(self) -> Float[Array, "*cameras 5"]:
        return self.coefficients

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        return ("k0", "k1", "k2", "k3", "k4")

    @property
    def focal_length(self) -> Float[Array, ""]:
        """That on the axis, 1/|k1|, in mm a radian."""
        return 1 / jnp.abs(self.coefficients[1])

    @property
    def principal_point(self) -> Float[Array, "2"]:
        return self.shift

    def corrected(
        self, scale: Float[Array, ""], shift: Float[Array, "2"], change: Float[Array, "5"]
    ) -> "FisheyePolynomial":
        # The focal length is 1/|k1|; at half the sensor's width all changes are angles.
        k, power = self.coefficients, jnp.arange(5)
        slope = jnp.where(k[1] != 0, jnp.abs(k[1]), 1)
        moved = shift / (slope * self.sensor) * jnp.array([-1, 1], k.dtype)
        return FisheyePolynomial(
            (k + change / (self.sensor[0] / 2) ** power) / scale**power,
            self.sensor,
            self.resolution,
            self.shift + moved,
            self.fov,
        )

    def resized(
        self, whole: tuple[int, int], box: Sequence[float], size: tuple[int, int]
    ) -> AbstractLens:
        corner, part = np.array(box[:2]), np.array(box[2:])
        sides = np.array([-1, 1])
        axis = (0.5 + np.asarray(self.shift, np.float64) * sides) * np.array(whole)
        return self._replaced(
            sensor=np.asarray(self.sensor, np.float64) * part / np.array(whole),
            resolution=np.array(size),
            shift=((axis - corner) / part - 0.5) * sides,
        )

    def record(self) -> LensRecord:
        sensor, shift = json_numbers(self.sensor), json_numbers(self.shift)
        block: dict[str, Any] = {
            "model": "blender_fisheye_polynomial",
            "k": json_numbers(self.coefficients),
            "sensor_width_mm": sensor[0],
            "sensor_height_mm": sensor[1],
            "fov": json_numbers(self.fov),
        }
        return LensRecord({"lens": {**block, "shift": shift} if any(shift) else block})

    def direction(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        xy = (pixel / self.resolution - self._axis()) * self.sensor
        r = safe_norm(xy)
        off_axis = r > 0
        theta = self._angle(r, self.coefficients)
        lit = jnp.abs(theta) <= self.fov / 2
        # No angle of azimuth: (x, y)/r is exact in all four quadrants and on the axis, where
        # sin(theta)/r becomes -k1. The pixel exactly on the axis looks along it, whatever k0.
        stretch = jnp.sin(theta) / jnp.where(off_axis, r, 1)
        stretch = jnp.where(off_axis, stretch, -self.coefficients[1])
        forward = jnp.where(off_axis, jnp.cos(theta), 1)
        return jnp.where(lit, jnp.append(stretch * xy, forward), 0)

    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        angle, axial, off_axis = axis_angle(point)
        reach = self._reach()
        # Mirroring polynomials have theta < 0: solve for |theta|, then take the other side.
        ends = self._angle(jnp.stack([jnp.zeros_like(reach), reach]), self.coefficients)
        side = jnp.where(ends[1] < ends[0], -1, 1).astype(angle.dtype)
        lowest, highest = side * ends
        imaged = (angle <= self.fov / 2) & (angle >= lowest) & (angle <= highest)
        # What lies straight behind has no side of the picture.
        imaged &= off_axis | (point[2] > 0)

        def angle_at(r, k):
            return side * self._angle(r, k)

        r = increasing_root(angle_at, jnp.where(imaged, angle, lowest), self.coefficients, reach)
        # On the axis r/axial becomes 1/(|k1| z), guarded for points that do not need it.
        slope = -self.coefficients[1] * point[2]
        limit = 1 / jnp.where(off_axis | (slope == 0), 1, slope)
        stretch = jnp.where(off_axis, side * r / axial, limit)
        pixel = (stretch * point[:2] / self.sensor + self._axis()) * self.resolution
        return jnp.where(imaged, pixel, jnp.nan)

    def check(self) -> None:
        for key in ("sensor", "resolution", "fov"):
            value = getattr(self, key)
            require(f"lens.{key}", value, lambda v: np.isfinite(v) & (v > 0), "above 0")
        require("lens.shift", self.shift, np.isfinite, "finite")
        require("lens.k", self.coefficients, np.isfinite, "finite")
        sensor, resolution, shift = (
            np.asarray(x, float) for x in (self.sensor, self.resolution, self.shift)
        )
        reach = np.linalg.norm((0.5 + np.abs(shift) + 2 / resolution) * sensor)
        r = np.linspace(0, float(reach), 1025)
        theta = -np.polynomial.polynomial.polyval(r, np.asarray(self.coefficients, float))
        lit = np.abs(theta) <= float(self.fov) / 2
        last = len(r) if lit.all() else int(np.argmin(lit))
        step = np.diff(theta[:last])
        if last < 2 or lit[last:].any() or not (np.all(step > 0) or np.all(step < 0)):
            raise ValueError(
                "lens.k must be monotone: theta = -(k0 + k1 r + ...) may not turn back between the "
                f"centre and the corner (r = {r[-1]:.4g} mm) of the picture, got "
                f"{np.asarray(self.coefficients).tolist()} with lens.fov {float(self.fov):.4g}. "
                "Fit the polynomial to the whole picture, or lower lens.fov."
            )

    def _axis(self) -> Float[Array, "2"]:
        """Where the optical axis meets the picture, as fractions of its width and height."""
        return 0.5 + self.shift * jnp.array([-1, 1], self.shift.dtype)

    def _angle(self, r: Float[Array, "*radii"], k: Float[Array, "5"]) -> Float[Array, "*radii"]:
        return -(k[0] + r * (k[1] + r * (k[2] + r * (k[3] + r * k[4]))))

    def _reach(self) -> Float[Array, ""]:
        """Largest r (mm) in the picture: its farthest corner, two pixels of filter included."""
        return safe_norm((0.5 + jnp.abs(self.shift) + 2 / self.resolution) * self.sensor)


def _from_options(film: Film, options: LensOptions) -> FisheyePolynomial:
    k, size = coefficients_of(options, 5), film_size(film)
    sensor = _sensor(film, options.sensor)
    if sensor is None:
        sensor = 2 * _sensor_radius(k, half_angle(options)) * size / size.min()
    return FisheyePolynomial(
        to_device(k),
        to_device(sensor, jnp.float32),
        to_device(size),
        to_device(np.zeros(2), jnp.float32),
        to_device(2 * half_crop(options), jnp.float32),
    )


def _sensor(film: Film, sensor: tuple[float, ...]) -> Float[np.ndarray, "2"] | None:
    """Width and height in mm of a sensor of square pixels, whose smaller side is as given; None if
    none is given.

    Raises:
        ValueError: `sensor` is no size, or its shape is not the picture's to half a pixel.
    """
    if not sensor:
        return None
    given, size = np.asarray(sensor, np.float64), np.array([film.width, film.height])
    if given.shape != (2,) or not np.all(np.isfinite(given) & (given > 0)):
        raise ValueError(
            "lens.sensor must be [width, height] in mm, two numbers above 0, got "
            f"{given.tolist()}. Write both sides, such as lens.sensor=[36,24]."
        )
    # As `physical.sensor`.
    if abs(size[1] - size[0] * given[1] / given[0]) > 0.5:
        part = np.min(given / size) * size
        raise ValueError(
            f"lens.sensor must have the shape of the picture, {film.width} x {film.height} pixels, "
            f"got {given.tolist()} mm. Give the part of the sensor that the picture shows, such as "
            f"lens.sensor=[{part[0]:.6g},{part[1]:.6g}], or a film.size of the sensor's shape."
        )
    return given.min() * size / size.min()


def _sensor_radius(k: Float[np.ndarray, "5"], half: float) -> float:
    """The smallest distance on the sensor, in mm, at which |theta| reaches an angle in radians."""
    radii = [
        root.real
        for side in (-1, 1)
        for root in np.polynomial.polynomial.polyroots([k[0] + side * half, *k[1:].astype(float)])
        if abs(root.imag) < 1e-9 * abs(root) and root.real > 0
    ]
    if not radii:
        raise ValueError(
            f"lens.k must reach half of lens.fov ({half:.6g} radians), got {k.tolist()}, whose "
            "theta(r) turns back before. Lower lens.fov, or give lens.sensor."
        )
    return min(radii)


def _from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> FisheyePolynomial:
    size = [keys.count("w"), keys.count("h")]
    for key, middle in (("cx", size[0] / 2), ("cy", size[1] / 2)):
        if not block.has("shift") and abs(keys.number(key, middle) - middle) > 1e-6:
            keys.warn(
                f"the key {key} is ignored by lens.model {block.text('model')}: its axis meets the "
                "picture's centre. Write lens.shift to move it."
            )
    sensor = [block.number("sensor_width_mm"), block.number("sensor_height_mm")]
    return FisheyePolynomial(
        coefficients=to_device(block.vector("k", 5), dtype),
        sensor=to_device(sensor, dtype),
        resolution=to_device(size, dtype),
        shift=to_device(block.vector("shift", 2, [0.0, 0.0]), dtype),
        fov=to_device(block.number("fov"), dtype),
    )


MODELS = (
    LensModel(
        name="fisheye_polynomial",
        from_options=_from_options,
        block="blender_fisheye_polynomial",
        from_keys=_from_keys,
        block_keys=("k", "fov", "sensor_width_mm", "sensor_height_mm", "shift"),
        option_keys=("fov", "k", "crop", "sensor"),
    ),
)
