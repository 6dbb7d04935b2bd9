"""NVIDIA's f-theta lens: any fisheye as a polynomial of degree up to six."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.film import Film
from gaussray.camera.lens.abstract import LensRecord
from gaussray.camera.lens.model import (
    LensKeys,
    LensModel,
    LensOptions,
    coefficients_of,
    film_size,
    focal_and_center,
    half_angle,
    half_crop,
)
from gaussray.camera.lens.radial import RadialLens
from gaussray.camera.roots import increasing_root
from gaussray.io.plain_values import number, to_device, vector
from gaussray.io.validate import require


# Which of NVIDIA's two polynomials the coefficients are: PIXELDIST_TO_ANGLE, ANGLE_TO_PIXELDIST.
POLYNOMIALS = ("angle_of_radius", "radius_of_angle")


class FTheta(RadialLens):
    """theta = k0 + k1 r + k2 r^2 + ... ("angle_of_radius") or r = k0 + k1 theta + ...
    ("radius_of_angle"), theta in radians and r in units of `focal`, which is 1 pixel in NVIDIA's
    files.

    The lowest coefficient comes first, k0 must be 0, the degree is 1 to 6, and `limit` is the r or
    theta at the rim of the picture (`limit_of_angle`). NVIDIA's files hold both polynomials and
    name the one that counts (reference_poly); here the other direction is its root, by bisection
    and Newton. Their linear_cde = (c, 0, 0) is focal = (c, 1); a shear (d, e) is left out.
    """

    focal: Float[Array, "2"] = eqx.field(converter=vector("lens.focal", 2, spread=True))
    center: Float[Array, "2"] = eqx.field(converter=vector("lens.center", 2))
    coefficients: Float[Array, " coefficients"] = eqx.field(converter=vector("lens.k"))
    limit: Float[Array, ""] = eqx.field(converter=number("lens.limit"))
    polynomial: str = eqx.field(static=True, default="angle_of_radius")

    linear_coefficient: ClassVar[int | None] = 1

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        return tuple(f"k{i}" for i in range(self.coefficients.shape[-1]))

    def coefficient_units(self) -> Float[Array, " coefficients"] | float:
        # At the rim all corrections are angles, or focal lengths.
        k = self.coefficients
        unit = 1 if self.polynomial == "angle_of_radius" else jnp.abs(k[1])
        return unit / self.limit ** jnp.arange(k.shape[0])

    def record(self) -> LensRecord:
        values = {"polynomial": self.polynomial, "k": self.coefficients, "limit": self.limit}
        return self.block_record("f_theta", values)

    @property
    def max_angle(self) -> Float[Array, ""]:
        if self.polynomial == "radius_of_angle":
            return self.limit
        return _value(self.limit, self.coefficients)

    def radius(self, theta: Float[Array, ""]) -> Float[Array, ""]:
        if self.polynomial == "radius_of_angle":
            return _value(theta, self.coefficients)
        return increasing_root(_value, theta, self.coefficients, self.limit)

    def angle(self, r: Float[Array, ""]) -> Float[Array, ""]:
        if self.polynomial == "radius_of_angle":
            return increasing_root(_value, r, self.coefficients, self.limit)
        return _value(r, self.coefficients)

    def slope(self) -> Float[Array, ""]:
        k1 = self.coefficients[1]
        return k1 if self.polynomial == "radius_of_angle" else 1 / k1

    def check_image(self) -> None:
        if self.polynomial not in POLYNOMIALS:
            raise ValueError(
                f"lens.polynomial must be one of {', '.join(POLYNOMIALS)}, got {self.polynomial!r}."
            )
        k = np.asarray(self.coefficients, float)
        if not 2 <= len(k) <= 7:
            raise ValueError(f"lens.k must hold 2 to 7 coefficients, k0 first, got {len(k)}.")
        require("lens.k", k, np.isfinite, "finite")
        require("lens.k", k, lambda k: (k[0] == 0) & (k[1] > 0), "0 first, then above 0")
        require("lens.limit", self.limit, lambda x: np.isfinite(x) & (x > 0), "above 0")
        rising = np.polynomial.polynomial.polyval(np.linspace(0, float(self.limit), 1025), k)
        if not np.all(np.diff(rising) > 0):
            raise ValueError(
                f"lens.k must be monotone: the polynomial may not turn back below its argument "
                f"{float(self.limit):.6g}, got {k.tolist()}. Lower lens.fov."
            )
        require("lens.fov", 2 * self.max_angle, lambda a: a <= 2 * np.pi * (1 + 1e-6), "<= 2 pi")


def limit_of_angle(k: tuple[float, ...] | list[float], max_angle: float, polynomial: str) -> float:
    """`FTheta.limit` of a half angle of view: the angle itself, or the first radius that has it.

    Args:
        k: coefficients, the lowest first.
        max_angle: half angle of view, in radians.
        polynomial: one of `POLYNOMIALS`.

    Raises:
        ValueError: An increasing theta(r) does not reach the angle.
    """
    if polynomial == "radius_of_angle":
        return max_angle
    roots = np.polynomial.polynomial.polyroots(np.subtract(k, [max_angle, *[0] * (len(k) - 1)]))
    real = [x.real for x in roots if abs(x.imag) < 1e-9 * abs(x) and x.real > 0]
    if not real:
        raise ValueError(
            f"lens.k must reach half of lens.fov ({max_angle:.6g} radians), got {list(k)}, whose "
            "theta(r) turns back before. Lower lens.fov."
        )
    return min(real)


def _value(x: Float[Array, ""], k: Float[Array, " coefficients"]) -> Float[Array, ""]:
    total = jnp.zeros_like(x)
    for i in reversed(range(k.shape[0])):
        total = total * x + k[i]
    return total


def _from_options(film: Film, options: LensOptions) -> FTheta:
    kind = options.polynomial
    if kind not in POLYNOMIALS:
        raise ValueError(f"lens.polynomial must be one of {', '.join(POLYNOMIALS)}, got {kind!r}.")
    k = coefficients_of(options, *range(2, 8))
    focal = 1.0
    if options.fov is not None:
        half = half_angle(options)
        rim = limit_of_angle(k.tolist(), half, kind)
        if kind == "radius_of_angle":
            rim = float(np.polynomial.polynomial.polyval(half, k))
        focal = float(film_size(film).min()) / 2 / rim
    if options.fov is None and options.crop is None:
        limit = _covering_limit(film, k.astype(np.float64), kind)
    else:
        limit = limit_of_angle(k.tolist(), half_crop(options), kind)
    return FTheta(
        focal=to_device(np.full(2, focal), jnp.float32),
        center=to_device(film_size(film) / 2),
        coefficients=to_device(k),
        limit=to_device(limit, jnp.float32),
        polynomial=kind,
    )  # type: ignore[call-arg]  # max_angle is a property


def _covering_limit(film: Film, k: Float[np.ndarray, " coefficients"], polynomial: str) -> float:
    """`FTheta.limit` of a lens of focal length 1 that fills its picture, corners and two pixels of
    filter included, or shows the whole sphere; of coefficients that `FTheta` refuses, any."""
    corner = float(np.hypot(*(film_size(film) / 2 + 2)))
    of_angle = polynomial == "radius_of_angle"
    reached, most = (corner, np.pi) if of_angle else (np.pi, corner)
    roots = np.polynomial.polynomial.polyroots(np.append(k[0] - reached, k[1:]))
    real = [x.real for x in roots if abs(x.imag) < 1e-9 * abs(x) and x.real > 0]
    limit = min([*real, most])
    place = np.linspace(0, limit, 1025)
    turns = np.diff(np.polynomial.polynomial.polyval(place, k)) <= 0
    if k[1] > 0 and turns.any():
        angle = place if of_angle else np.polynomial.polynomial.polyval(place, k)
        widest = 2 * np.rad2deg(angle[int(np.argmax(turns))])
        raise ValueError(
            f"lens.k must be monotone up to the corners of a picture of {film.width} x "
            f"{film.height} pixels, got {np.float32(k).tolist()}, which turn back at {widest:.4g} "
            "degrees across. Give lens.crop, or a smaller picture."
        )
    return limit


def _from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> FTheta:
    kind, k = block.choice("polynomial", POLYNOMIALS), block.numbers("k")
    limit = block.number("limit", 0.0) or limit_of_angle(k, block.number("fov") / 2, kind)
    focal, center = focal_and_center(keys, dtype)
    return FTheta(
        focal=focal,
        center=center,
        coefficients=to_device(k, dtype),
        limit=to_device(limit, dtype),
        polynomial=kind,
    )  # type: ignore[call-arg]  # max_angle is a property


MODELS = (
    LensModel(
        name="f_theta",
        from_options=_from_options,
        block="f_theta",
        from_keys=_from_keys,
        block_keys=("k", "fov", "polynomial", "limit"),
        any_size=False,
        option_keys=("fov", "k", "crop", "polynomial"),
    ),
)
