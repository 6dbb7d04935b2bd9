"""The matter of a scene: anisotropic Gaussians with view-dependent colour."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.geometry import rotation_matrix
from gaussray.io.plain_values import readable, rows, to_array, vector
from gaussray.io.validate import require
from gaussray.scene.harmonics import C0, constant_harmonics


# Coefficients of harmonics of degree 0 to 3.
HARMONIC_COUNTS = (1, 4, 9, 16)


def _harmonics(value: Any) -> Any:
    return to_array("gaussians.harmonics", value, "numbers, n x 1, 4, 9 or 16 x 3", (None, None, 3))


class Gaussians(eqx.Module):
    """Gaussians in physical values, a structure of arrays.

    Args:
        mean: centres, in scene units.
        quat: rotations (w, x, y, z) from the principal axes to the world, of any non-zero length.
        scale: standard deviations along the principal axes, above 0, in scene units.
        opacity: peak alpha in [0, 1].
        harmonics: (L+1)^2 spherical-harmonics coefficients of linear colour.
        tint: factor of the colour, per channel, for shading that changes over time; None is 1.

    Raises:
        ValueError: The arrays are not of equally many Gaussians, or the harmonics of no degree from
            0 to 3.
    """

    mean: Float[Array, "*keys gaussians 3"] = eqx.field(converter=rows("gaussians.mean", 3))
    quat: Float[Array, "*keys gaussians 4"] = eqx.field(converter=rows("gaussians.quat", 4))
    scale: Float[Array, "*keys gaussians 3"] = eqx.field(converter=rows("gaussians.scale", 3))
    opacity: Float[Array, " gaussians"] = eqx.field(converter=vector("gaussians.opacity"))
    harmonics: Float[Array, "gaussians coefficients 3"] = eqx.field(converter=_harmonics)
    tint: Float[Array, "*keys gaussians 3"] | None = None

    def __check_init__(self):
        given = {name: value for name, value in vars(self).items() if value is not None}
        shapes = {name: x.shape for name, x in given.items() if hasattr(x, "shape")}
        # Trees of other things than arrays have this type, too.
        if len(shapes) == len(given):
            _check_shapes(shapes)

    @property
    def count(self) -> int:
        """How many Gaussians the arrays hold."""
        return self.opacity.shape[0]

    @classmethod
    def colored(
        cls, mean: Any, color: Any, *, scale: Any = 0.01, opacity: Any = 0.9, quat: Any = None
    ) -> "Gaussians":
        """Gaussians whose colours are the same from everywhere.

        Args:
            mean: centres in scene units, n x 3.
            color: red, green and blue in linear light (1 is white), n x 3, or one for all.
            scale: standard deviations in scene units: one number, one for each axis, or n x 3.
            opacity: peak alpha in [0, 1], one or n of them.
            quat: rotations (w, x, y, z), one or n x 4; None is none.

        Raises:
            ValueError: The numbers are not as many as there are centres or not finite, a scale is
                not above 0, an opacity not from 0 to 1, or a rotation zero.
        """
        mean = rows("gaussians.mean", 3)(mean)
        count = mean.shape[0]

        def each(name: str, value: Any, *shape: int) -> Array:
            try:
                array = jnp.asarray(value, mean.dtype)
            except (TypeError, ValueError):
                raise ValueError(f"gaussians.{name} must be numbers, got {value!r}.") from None
            if array.ndim == 1 and shape:
                array = array[None]
            try:
                return jnp.broadcast_to(array, (count, *shape))
            except ValueError:
                raise ValueError(
                    f"gaussians.{name} must be one for all or one for each of the {count} "
                    f"Gaussians, got the shape {array.shape}."
                ) from None

        turn = each("quat", (1, 0, 0, 0) if quat is None else quat, 4)
        paint = each("color", color, 3)
        scale, opacity = each("scale", scale, 3), each("opacity", opacity)
        for name, value in (("mean", mean), ("color", paint), ("quat", turn), ("scale", scale)):
            require(f"gaussians.{name}", value, np.isfinite, "finite")
        require("gaussians.quat", turn, _is_turn, "not zero", "(1, 0, 0, 0) is no rotation.")
        require("gaussians.scale", scale, lambda s: s > 0, "above 0")
        require("gaussians.opacity", opacity, lambda o: (o >= 0) & (o <= 1), "from 0 to 1")
        return cls(mean, turn, scale, opacity, constant_harmonics(paint, 0))

    def __repr__(self) -> str:
        # Trees of other things than arrays (shapes, specifications) have this type, too.
        if not all(map(eqx.is_array, (self.mean, self.opacity, self.harmonics))):
            return readable(self)
        keys = "" if self.mean.ndim == 2 else f" at {self.mean.shape[0]} times"
        degree = math.isqrt(self.harmonics.shape[-2]) - 1
        return f"Gaussians({self.count:,}{keys}, degree {degree}, {self.mean.dtype})"


def _is_turn(quat: np.ndarray) -> np.ndarray:
    """For each number of quaternions, whether its quaternion is not zero."""
    return np.broadcast_to(np.any(quat != 0, axis=-1, keepdims=True), quat.shape)


def _check_shapes(shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Check that arrays are of equally many Gaussians, whatever key states some have.

    Args:
        shapes: the shape of each array by its name. Within `vmap` over Gaussians, that of one.
    """
    lead = shapes["opacity"][:-1]
    # A stack of sets has leading axes in all arrays.
    if lead and all(x[: len(lead)] == lead for x in shapes.values()):
        shapes = {name: x[len(lead) :] for name, x in shapes.items()}
    count, harmonics = shapes["opacity"], shapes["harmonics"]
    if len(count) > 1 or len(shapes["mean"]) <= len(count):
        raise ValueError(
            f"gaussians.opacity must be one number for each Gaussian, got the shape {count}."
        )
    if harmonics[-2:-1] not in {(n,) for n in HARMONIC_COUNTS} or harmonics[:-2] != count:
        wanted = "".join(f"{n} x " for n in count)
        raise ValueError(
            f"gaussians.harmonics must be {wanted}1, 4, 9 or 16 x 3 numbers, got the shape "
            f"{harmonics}. Gaussians.colored takes plain colours."
        )
    keys = shapes["mean"][: len(shapes["mean"]) - 1 - len(count)]
    for name in ("mean", "quat", "scale", "tint"):
        if name in shapes and shapes[name][:-1] != (*keys, *count):
            raise ValueError(
                f"gaussians.{name} must be one for each of the {math.prod(count)} Gaussians that "
                f"gaussians.opacity has, got the shape {shapes[name]}."
            )


class Unconstrained(eqx.Module):
    """Gaussians in the unconstrained values of the optimiser: log scale, logit of opacity."""

    mean: Float[Array, "gaussians 3"]
    quat: Float[Array, "gaussians 4"]
    log_scale: Float[Array, "gaussians 3"]
    logit_opacity: Float[Array, " gaussians"]
    harmonics: Float[Array, "gaussians coefficients 3"]


@jax.jit
def constrain(free: Unconstrained) -> Gaussians:
    """Physical values: scale = exp(log_scale), opacity = sigmoid(logit_opacity)."""
    return Gaussians(
        mean=free.mean,
        quat=free.quat,
        scale=jnp.exp(free.log_scale),
        opacity=jax.nn.sigmoid(free.logit_opacity),
        harmonics=free.harmonics,
    )


@jax.jit
def unconstrain(gaussians: Gaussians) -> Unconstrained:
    """Inverse of `constrain`; opacity is kept a rounding step away from 0 and 1."""
    tiny = jnp.finfo(gaussians.opacity.dtype).eps
    opacity = jnp.clip(gaussians.opacity, tiny, 1 - tiny)
    return Unconstrained(
        mean=gaussians.mean,
        quat=gaussians.quat,
        log_scale=jnp.log(gaussians.scale),
        logit_opacity=jnp.log(opacity) - jnp.log1p(-opacity),
        harmonics=gaussians.harmonics,
    )


def concatenate(first: Gaussians, second: Gaussians) -> Gaussians:
    """Both sets as one, in order.

    Args:
        first, second: Gaussians, with or without a leading axis of key states. A set without one is
            repeated at each key of the other. Harmonics of the lower degree are padded with zeros.
    """
    keys = jnp.broadcast_shapes(first.mean.shape[:-2], second.mean.shape[:-2])

    def join(a: Array, b: Array, trailing: int) -> Array:
        a = jnp.broadcast_to(a, keys + a.shape[a.ndim - trailing :])
        b = jnp.broadcast_to(b, keys + b.shape[b.ndim - trailing :])
        return jnp.concatenate([a, b], axis=len(keys))

    def tint(g: Gaussians) -> Array:
        return jnp.ones_like(g.mean) if g.tint is None else g.tint

    degree = max(first.harmonics.shape[1], second.harmonics.shape[1])
    plain = first.tint is None and second.tint is None
    return Gaussians(
        mean=join(first.mean, second.mean, 2),
        quat=join(first.quat, second.quat, 2),
        scale=join(first.scale, second.scale, 2),
        opacity=jnp.concatenate([first.opacity, second.opacity]),
        harmonics=jnp.concatenate([_pad(first.harmonics, degree), _pad(second.harmonics, degree)]),
        tint=None if plain else join(tint(first), tint(second), 2),
    )


def _pad(harmonics: Array, coefficients: int) -> Array:
    missing = coefficients - harmonics.shape[1]
    return jnp.pad(harmonics, ((0, 0), (0, missing), (0, 0)))


def fold_tint(gaussians: Gaussians) -> Gaussians:
    """Fold the tint into the harmonics: the same colours without a tint.

    (1/2 + sum c_i Y_i) tint is 1/2 + sum c'_i Y_i with c'_i = tint c_i, and the constant one
    also gains (tint - 1) / (2 Y_0). A tint is positive, so colours that were clamped at black stay
    black.
    """
    if gaussians.tint is None:
        return gaussians
    tint = gaussians.tint[:, None, :]
    harmonics = (gaussians.harmonics * tint).at[:, :1].add((tint - 1) * (0.5 / C0))
    parts = gaussians.mean, gaussians.quat, gaussians.scale, gaussians.opacity
    return Gaussians(*parts, harmonics)


def times_factor(gaussians: Gaussians, factor: Float[Array, "#gaussians #3"]) -> Gaussians:
    """The same colours times a factor, as harmonics (`fold_tint`).

    Args:
        gaussians: Gaussians at one time.
        factor: above 0, of each Gaussian and channel, or the same for all.
    """
    own = jnp.ones((), factor.dtype) if gaussians.tint is None else gaussians.tint
    tint = jnp.broadcast_to(own * factor, gaussians.mean.shape)
    return fold_tint(replace(gaussians, tint=tint))


def whitening_matrix(
    quat: Float[Array, "*batch 4"], scale: Float[Array, "*batch 3"]
) -> Float[Array, "*batch 3 3"]:
    """A = S^-1 R^T: takes a world vector to the frame in which the Gaussian is the unit sphere.

    Args:
        quat: unit quaternions (w, x, y, z) of R, from the Gaussian's axes to the world.
        scale: standard deviations along the axes, scene units.
    """
    return jnp.swapaxes(rotation_matrix(quat), -1, -2) / scale[..., :, None]


def principal_axes(
    quat: Float[Array, "*batch 4"], scale: Float[Array, "*batch 3"]
) -> Float[Array, "*batch 3 3"]:
    """F = R S: the principal axes as columns, one standard deviation long; F F^T = covariance.

    Args:
        quat: unit quaternions (w, x, y, z) of R, from the Gaussian's axes to the world.
        scale: standard deviations along the axes, scene units.
    """
    return rotation_matrix(quat) * scale[..., None, :]
