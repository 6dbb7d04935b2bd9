"""Which way each pixel looks.

Camera axes are +x right, +y down, +z forward. Pixels are (column, row), their centres at +0.5.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.camera.checks import known, require
from gaussray.camera.distortion import distort, undistort, unfolded
from gaussray.camera.inverse import increasing_root
from gaussray.geometry import normalize, safe_norm


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
            self.check()

    def sees(self, pixel: Float[Array, "2"]) -> Bool[Array, ""]:
        """Whether the lens forms a ray for this pixel."""
        return jnp.any(self.direction(pixel) != 0)


class Pinhole(AbstractLens):
    """Perspective: pixel = center + focal (x/z, y/z), distorted as by OpenCV (`distortion.py`).

    `distorted` says whether the coefficients can differ from zero; an ideal pinhole without it pays
    nothing for them. `pinhole` decides that.
    """

    focal: Float[Array, "2"]
    center: Float[Array, "2"]
    distortion: Float[Array, "8"]
    distorted: bool = eqx.field(static=True, default=True)

    def direction(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        xy = (pixel - self.center) / self.focal
        if not self.distorted:
            return normalize(jnp.append(xy, 1))
        xy, found = undistort(self.distortion, xy)
        return jnp.where(found, normalize(jnp.append(xy, 1)), 0)

    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        imaged = point[2] > 0
        xy = point[:2] / jnp.where(imaged, point[2], 1)
        if self.distorted:
            imaged &= unfolded(self.distortion, xy)
            xy = distort(self.distortion, xy)
        return jnp.where(imaged, self.center + self.focal * xy, jnp.nan)

    def check(self) -> None:
        require("lens.focal", self.focal, lambda f: np.isfinite(f) & (f > 0), "above 0")
        require("lens.center", self.center, np.isfinite, "finite")
        require("lens.distortion", self.distortion, np.isfinite, "finite")
        if not self.distorted:
            remedy = "Build the lens with `pinhole`."
            require("lens.distortion", self.distortion, lambda k: k == 0, "0 here", remedy)


def pinhole(
    focal: Float[Array, "2"],
    center: Float[Array, "2"],
    distortion: Float[Array, "8"] | None = None,
) -> Pinhole:
    """Perspective lens that pays for distortion only if there is some (or if it is traced)."""
    if distortion is None:
        return Pinhole(focal, center, jnp.zeros(8, focal.dtype), distorted=False)
    return Pinhole(
        focal, center, distortion, distorted=not known(distortion) or bool(np.any(distortion))
    )


class FisheyePolynomial(AbstractLens):
    """Blender's FISHEYE_LENS_POLYNOMIAL: theta = -(k0 + k1 r + k2 r^2 + k3 r^3 + k4 r^4).

    r is the distance on the sensor in millimetres, theta the angle from the axis in radians;
    ordinary lenses have negative k1, and a negative theta looks to the opposite side (a picture
    mirrored through its centre). `sensor` is (width, height) in mm, `resolution` the same picture
    in pixels, `shift` Blender's (fractions of the sensor, +x right, +y up). Beyond `fov`/2 it is
    black.
    """

    coefficients: Float[Array, "5"]
    sensor: Float[Array, "2"]
    resolution: Float[Array, "2"]
    shift: Float[Array, "2"]
    fov: Float[Array, ""]

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
        angle, axial, off_axis = _polar(point)
        reach = self._reach()
        # Mirroring polynomials have theta < 0: solve for |theta|, then take the other side.
        ends = self._angle(jnp.stack([jnp.zeros_like(reach), reach]), self.coefficients)
        side = jnp.where(ends[1] < ends[0], -1, 1).astype(angle.dtype)
        lowest, highest = side * ends
        imaged = (angle <= self.fov / 2) & (angle >= lowest) & (angle <= highest)
        imaged &= jnp.any(point != 0)

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
        r = np.linspace(0, float(self._reach()), 1025)
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


class KannalaBrandt(AbstractLens):
    """r(theta) = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), in focal lengths.

    OpenCV's fisheye. `max_angle` is the half angle of view: r(theta) must increase up to it, and
    the picture is black beyond it.
    """

    focal: Float[Array, "2"]
    center: Float[Array, "2"]
    coefficients: Float[Array, "4"]
    max_angle: Float[Array, ""]

    def direction(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        xy = (pixel - self.center) / self.focal
        r = safe_norm(xy)
        lit = r <= self._radius(self.max_angle, self.coefficients)
        inside = jnp.where(lit, r, 0)
        theta = increasing_root(self._radius, inside, self.coefficients, self.max_angle)
        off_axis = r > 0
        stretch = jnp.where(off_axis, jnp.sin(theta) / jnp.where(off_axis, r, 1), 1)
        return jnp.where(lit, jnp.append(stretch * xy, jnp.cos(theta)), 0)

    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        angle, axial, off_axis = _polar(point)
        imaged = (angle <= self.max_angle) & jnp.any(point != 0)
        limit = 1 / jnp.where(off_axis | (point[2] == 0), 1, point[2])
        stretch = jnp.where(off_axis, self._radius(angle, self.coefficients) / axial, limit)
        pixel = self.center + self.focal * stretch * point[:2]
        return jnp.where(imaged, pixel, jnp.nan)

    def check(self) -> None:
        require("lens.focal", self.focal, lambda f: np.isfinite(f) & (f > 0), "above 0")
        require("lens.center", self.center, np.isfinite, "finite")
        require("lens.k", self.coefficients, np.isfinite, "finite")
        angle = self.max_angle
        require("lens.max_angle", angle, lambda a: (a > 0) & (a <= np.pi), "in (0, pi]")
        theta = np.linspace(0, float(angle), 1025)
        powers = theta[:, None] ** np.array([3, 5, 7, 9])
        if np.any(np.diff(theta + powers @ np.asarray(self.coefficients, float)) <= 0):
            raise ValueError(
                "lens.k must be monotone: r(theta) may not turn back below lens.max_angle = "
                f"{float(angle):.4g}, got {np.asarray(self.coefficients).tolist()}. "
                "Lower lens.max_angle."
            )

    def _radius(self, theta: Float[Array, ""], k: Float[Array, "4"]) -> Float[Array, ""]:
        square = theta * theta
        return theta * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))


def _polar(
    point: Float[Array, "3"],
) -> tuple[Float[Array, ""], Float[Array, ""], Bool[Array, ""]]:
    """Angle of a point from the optical axis, its distance from the axis (1 on it), and whether it
    lies off it."""
    away = safe_norm(point[:2])
    off_axis = away > 0
    axial = jnp.where(off_axis, away, 1)
    on_axis_angle = jnp.where(point[2] < 0, jnp.pi, 0).astype(point.dtype)
    return jnp.where(off_axis, jnp.arctan2(axial, point[2]), on_axis_angle), axial, off_axis


def _round_trip(
    lens: AbstractLens, pixel: Float[Array, "pixels 2"]
) -> tuple[Bool[Array, " pixels"], Float[Array, "pixels 2"]]:
    """Whether the lens sees each pixel, and the pixel that its ray comes back to."""
    direction = jax.vmap(lens.direction)(pixel)
    return jnp.any(direction != 0, axis=-1), jax.vmap(lens.project)(direction)


def check_lens(lens: AbstractLens, width: int, height: int) -> None:
    """Raise unless the lens is valid and every pixel has a direction of its own.

    A coarse grid over the picture is sent through `direction` and back through `project`. Black
    pixels are no error, except under a pinhole, where they mean that the distortion folds.
    """
    lens.check()
    side = np.linspace(0, 1, 9)
    pixel = np.stack(np.meshgrid(side * width, side * height), axis=-1).reshape(-1, 2)
    pixel = jnp.asarray(pixel, jnp.result_type(*jax.tree.leaves(lens)))
    lit, back = jax.jit(_round_trip)(lens, pixel)
    close = np.max(np.abs(back - pixel), axis=-1) < 0.1
    wrong = np.where(lit, ~close, isinstance(lens, Pinhole))
    if wrong.any():
        key = "lens.distortion" if isinstance(lens, Pinhole) else "lens.k"
        raise ValueError(
            f"{key} must give every pixel a direction of its own, got none or another pixel's at "
            f"{np.asarray(pixel)[wrong][0].tolist()} (column, row). Use weaker coefficients or a "
            "smaller picture."
        )
