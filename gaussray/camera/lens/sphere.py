"""Lenses that project through the surface of one or two unit spheres, in closed form both ways."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.film import Film
from gaussray.camera.lens.abstract import LensRecord
from gaussray.camera.lens.model import LensKeys, LensModel, LensOptions, coefficients_of
from gaussray.camera.lens.radial import RadialLens, lens_of_keys, lens_of_options, safe_sqrt
from gaussray.io.plain_values import number, vector
from gaussray.io.validate import require


class UnifiedSphere(RadialLens):
    """UCM and EUCM: (x, y) / (alpha sqrt(beta (x^2 + y^2) + z^2) + (1 - alpha) z).

    `coefficients` are (alpha, beta) of the enhanced unified model (Khomutenko et al. 2016); beta =
    1 is the unified one (Mei's xi is alpha / (1 - alpha), his focal lengths are (1 - alpha) times
    smaller), alpha = 0 a pinhole. `focal` is that on the axis.
    """

    focal: Float[Array, "2"] = eqx.field(converter=vector("lens.focal", 2, spread=True))
    center: Float[Array, "2"] = eqx.field(converter=vector("lens.center", 2))
    coefficients: Float[Array, "2"] = eqx.field(converter=vector("lens.k", 2))
    max_angle: Float[Array, ""] = eqx.field(converter=number("lens.max_angle"))

    def radius(self, theta: Float[Array, ""]) -> Float[Array, ""]:
        alpha, beta = self.coefficients
        sine, cosine = jnp.sin(theta), jnp.cos(theta)
        distance = jnp.sqrt(beta * sine * sine + cosine * cosine)
        return sine / (alpha * distance + (1 - alpha) * cosine)

    def angle(self, r: Float[Array, ""]) -> Float[Array, ""]:
        alpha, beta = self.coefficients
        square = beta * r * r
        above = 1 - alpha * alpha * square
        below = alpha * safe_sqrt(1 - (2 * alpha - 1) * square) + 1 - alpha
        # above / below is z at distance r from the axis; below is 0 only for alpha = 1 at the rim.
        return jnp.arctan2(r * below, above)

    def slope(self) -> Float[Array, ""]:
        return jnp.ones_like(self.max_angle)

    def check_image(self) -> None:
        alpha, beta = self.coefficients
        require("lens.k (alpha)", alpha, lambda a: (a >= 0) & (a <= 1), "in [0, 1]")
        require("lens.k (beta)", beta, lambda b: np.isfinite(b) & (b > 0), "above 0")
        self.check_radial()

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        return ("alpha", "beta")

    def record(self) -> LensRecord:
        values = {"k": self.coefficients, "fov": 2 * self.max_angle}
        return self.block_record("enhanced_unified_sphere", values)


class DoubleSphere(RadialLens):
    """(x, y) / (alpha d + (1 - alpha) (xi |p| + z)), d = |(x, y, xi |p| + z)|.

    Usenko, Demmel and Cremers (2018). `coefficients` are (xi, alpha); xi = 0 is the unified sphere.
    On the axis the focal length is focal / (1 + xi). Valid up to theta where r turns back or, for
    alpha > 1/2, cos(theta) = -w2 of the paper; such lenses see more than 180 degrees.
    """

    focal: Float[Array, "2"] = eqx.field(converter=vector("lens.focal", 2, spread=True))
    center: Float[Array, "2"] = eqx.field(converter=vector("lens.center", 2))
    coefficients: Float[Array, "2"] = eqx.field(converter=vector("lens.k", 2))
    max_angle: Float[Array, ""] = eqx.field(converter=number("lens.max_angle"))

    def radius(self, theta: Float[Array, ""]) -> Float[Array, ""]:
        xi, alpha = self.coefficients
        sine, z = jnp.sin(theta), xi + jnp.cos(theta)
        return sine / (alpha * safe_sqrt(sine * sine + z * z) + (1 - alpha) * z)

    def angle(self, r: Float[Array, ""]) -> Float[Array, ""]:
        xi, alpha = self.coefficients
        square = r * r
        # The ray from the second sphere's centre is (r below, above), scaled.
        above = 1 - alpha * alpha * square
        below = alpha * safe_sqrt(1 - (2 * alpha - 1) * square) + 1 - alpha
        across = r * below
        length = above * above + across * across
        reach = above * xi + safe_sqrt(above * above + (1 - xi * xi) * across * across)
        return jnp.arctan2(reach * across, reach * above - xi * length)

    def slope(self) -> Float[Array, ""]:
        return 1 / (1 + self.coefficients[0])

    def check_image(self) -> None:
        xi, alpha = self.coefficients
        require("lens.k (xi)", xi, lambda x: (x > -1) & (x <= 1), "in (-1, 1]")
        require("lens.k (alpha)", alpha, lambda a: (a >= 0) & (a <= 1), "in [0, 1]")
        self.check_radial()

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        return ("xi", "alpha")

    def record(self) -> LensRecord:
        values = {"k": self.coefficients, "fov": 2 * self.max_angle}
        return self.block_record("double_sphere", values)


def _unified_from_options(film: Film, options: LensOptions) -> UnifiedSphere:
    if options.model == "unified_sphere":
        k = np.append(coefficients_of(options, 1), 1)
    else:
        k = coefficients_of(options, 2)
    return lens_of_options(film, options, UnifiedSphere, k)


def _unified_from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> UnifiedSphere:
    enhanced = block.text("model") == "enhanced_unified_sphere"
    k = block.vector("k", 2) if enhanced else [*block.vector("k", 1), 1.0]
    return lens_of_keys(UnifiedSphere, keys, dtype, k, block.number("fov") / 2)


def _double_from_options(film: Film, options: LensOptions) -> DoubleSphere:
    return lens_of_options(film, options, DoubleSphere, coefficients_of(options, 2))


def _double_from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> DoubleSphere:
    half, k = block.number("fov") / 2, block.vector("k", 2)
    return lens_of_keys(DoubleSphere, keys, dtype, k, half)


MODELS = (
    *(
        LensModel(
            name=name,
            from_options=_unified_from_options,
            block=name,
            from_keys=_unified_from_keys,
            block_keys=("k", "fov"),
            widest=widest,
        )
        for name, widest in (("unified_sphere", 260.0), ("enhanced_unified_sphere", 265.0))
    ),
    LensModel(
        name="double_sphere",
        from_options=_double_from_options,
        block="double_sphere",
        from_keys=_double_from_keys,
        block_keys=("k", "fov"),
        widest=245.0,
    ),
)
