"""The radial division model: distortion of a perspective lens as a closed form of the ray."""

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
)
from gaussray.camera.lens.radial import RadialLens, safe_sqrt
from gaussray.camera.roots import increasing_root
from gaussray.io.plain_values import number, to_device, vector
from gaussray.io.validate import require


class Division(RadialLens):
    """r_u = r_d / (1 + lambda1 r_d^2 + lambda2 r_d^4), with r_u = tan(theta).

    Fitzgibbon, "Simultaneous linear estimation of multiple view geometry and lens distortion"
    (2001). r_d is the distance of the pixel from the distortion centre in focal lengths, r_u that
    of the undistorted point, theta the angle of the ray from the optical axis. A pixel (x, y) looks
    along (x, y, 1 + lambda1 r_d^2 + lambda2 r_d^4): beyond 90 degrees, too, if the last number is
    negative. Negative coefficients are barrel distortion, zeros a pinhole.

    Both directions have closed forms with one coefficient, r_d = 2 tan(theta) / (1 + sqrt(1 -
    4 lambda1 tan^2(theta))); with two, r_d is found by bisection and Newton.

    Args:
        focal: focal lengths in pixels.
        center: distortion centre and principal point in pixels.
        coefficients: lambda1, or lambda1 and lambda2, without unit.
        limit: largest r_d of the picture, in focal lengths; black beyond. theta must increase up to
            it: 1 - lambda1 r_d^2 - 3 lambda2 r_d^4 > 0.

    Raises:
        ValueError: If a number is invalid or theta(r_d) turns back below `limit`.
    """

    focal: Float[Array, "2"] = eqx.field(converter=vector("lens.focal", 2, spread=True))
    center: Float[Array, "2"] = eqx.field(converter=vector("lens.center", 2))
    coefficients: Float[Array, " coefficients"] = eqx.field(converter=vector("lens.k"))
    limit: Float[Array, ""] = eqx.field(converter=number("lens.limit"))

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        return ("lambda1", "lambda2")[: self.coefficients.shape[-1]]

    @property
    def max_angle(self) -> Float[Array, ""]:
        return _angle(self.limit, self.coefficients)

    def radius(self, theta: Float[Array, ""]) -> Float[Array, ""]:
        if self.coefficients.shape[0] > 1:
            return increasing_root(_angle, theta, self.coefficients, self.limit)
        # The root of lambda1 sin r^2 - cos r + sin = 0 that is theta at the centre, without
        # cancellation and without a pole of the tangent.
        sine, cosine = jnp.sin(theta), jnp.cos(theta)
        square = cosine * cosine - 4 * self.coefficients[0] * sine * sine
        return 2 * sine / (cosine + safe_sqrt(square))

    def angle(self, r: Float[Array, ""]) -> Float[Array, ""]:
        return _angle(r, self.coefficients)

    def slope(self) -> Float[Array, ""]:
        return jnp.ones_like(self.limit)

    def check_image(self) -> None:
        k = np.asarray(self.coefficients, np.float64)
        if len(k) not in (1, 2):
            raise ValueError(f"lens.k must hold 1 or 2 coefficients, got {len(k)}.")
        require("lens.k", k, np.isfinite, "finite")
        require("lens.limit", self.limit, lambda x: np.isfinite(x) & (x > 0), "above 0")
        most = fold_radius(k)
        if float(self.limit) >= most:
            raise ValueError(
                f"lens.k must be monotone: theta may not turn back below lens.limit = "
                f"{float(self.limit):.6g} focal lengths, got {k.tolist()}, which turn back at "
                f"{most:.6g}. Lower lens.limit or lens.fov."
            )

    def record(self) -> LensRecord:
        values = {"k": self.coefficients, "limit": self.limit}
        return self.block_record("division", values)


def fold_radius(k: Float[np.ndarray, " coefficients"]) -> float:
    """The distance r_d at which theta(r_d) turns back, infinity if it never does.

    It is the smallest positive root of 1 - lambda1 r^2 - 3 lambda2 r^4.
    """
    squares = np.polynomial.polynomial.polyroots([1, *np.multiply(k, -np.array([1, 3])[: len(k)])])
    real = [x.real for x in squares if abs(x.imag) < 1e-9 * abs(x) and x.real > 0]
    return float(np.sqrt(min(real))) if real else np.inf


def _angle(r: Float[Array, ""], k: Float[Array, " coefficients"]) -> Float[Array, ""]:
    square = r * r
    forward = 1 + square * (k[0] if k.shape[0] == 1 else k[0] + square * k[1])
    return jnp.arctan2(r, forward)


def _radius_of(half: float, k: Float[np.ndarray, " coefficients"]) -> float:
    """r_d of an angle in radians: the smallest positive root of sin(theta) (1 + lambda1 r^2 +
    lambda2 r^4) - cos(theta) r, if theta(r_d) increases up to it."""
    polynomial = np.zeros(2 * len(k) + 1)
    polynomial[0], polynomial[2::2] = 1, k
    polynomial *= np.sin(half)
    polynomial[1] = -np.cos(half)
    roots = np.polynomial.polynomial.polyroots(np.trim_zeros(polynomial, "b"))
    real = [x.real for x in roots if abs(x.imag) < 1e-9 * abs(x) and x.real > 0]
    if not real or min(real) >= fold_radius(k):
        raise ValueError(
            f"lens.k must reach half of lens.fov ({half:.6g} radians), got {list(map(float, k))}, "
            "whose theta(r) turns back before. Lower lens.fov."
        )
    return min(real)


def _covering(
    corner: float, k: Float[np.ndarray, " coefficients"], dtype: DTypeLike
) -> Float[Array, ""]:
    """The limit of a lens that fills its picture as far as the model is valid; `corner` is the
    largest distance in the picture in focal lengths."""
    return to_device(min(corner, 0.999 * fold_radius(k)), dtype)


def _from_options(film: Film, options: LensOptions) -> Division:
    k, size = coefficients_of(options, 1, 2), film_size(film)
    focal = float(size[0]) / 2 / _radius_of(half_angle(options, 179.0), k.astype(np.float64))
    return Division(
        focal=to_device(np.full(2, focal), jnp.float32),
        center=to_device(size / 2),
        coefficients=to_device(k),
        limit=_covering(float(np.hypot(*(size / 2 + 2)) / focal), k, jnp.float32),
    )  # type: ignore[call-arg]  # max_angle is a property


def _from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> Division:
    k = np.array(block.numbers("k"))
    focal, center = focal_and_center(keys, dtype)
    if block.has("limit"):
        limit = to_device(block.number("limit"), dtype)
    elif block.has("fov"):
        limit = to_device(_radius_of(block.number("fov") / 2, k), dtype)
    else:
        size = np.array([keys.count("w"), keys.count("h")])
        reach = np.maximum(np.asarray(center), size - np.asarray(center)) + 2
        limit = _covering(float(np.hypot(*(reach / np.asarray(focal)))), k, dtype)
    return Division(focal=focal, center=center, coefficients=to_device(k, dtype), limit=limit)  # type: ignore[call-arg]  # max_angle is a property


MODELS = (
    LensModel(
        name="division",
        label="distortion",
        from_options=_from_options,
        block="division",
        from_keys=_from_keys,
        block_keys=("k", "fov", "limit"),
        perspective=True,
        option_keys=("fov", "k"),
        widest=120.0,
    ),
)
